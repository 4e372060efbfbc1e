"""Settings of the fit of amodal boxes."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting, table
from upvl_cli.errors import BadSetting
from upvl_cli.perception.registration.config import RegistrationConfig


@dataclass(frozen=True)
class TrackRegistrationConfig(Config):
    """How the clouds of one object are registered with each other (MI-UP, section 4.3)."""

    enabled: bool = setting(
        "register the clouds of a track with each other; without, its size is that of its tight boxes"
    )
    min_points: int = setting("fewest points of a cloud that is registered", ge=3, le=10**6)
    min_frames: int = setting(
        "fewest registered frames of a track; with fewer, none of its frames counts as registered",
        ge=1,
        le=10**6,
    )
    voxel_m: float = setting(
        "edge length of the voxels that clouds are thinned with before registration", "m", ge=0.001, le=10
    )
    max_points: int = setting("most points of a thinned cloud that take part in ICP", ge=3, le=10**6)
    icp: RegistrationConfig = table("alignment of one cloud with those registered before")


@dataclass(frozen=True)
class EdgeConfig(Config):
    """Where the points of an object end."""

    trim_share: float = setting(
        "share of the points left out at each end of length and width, as stray returns", ge=0, le=0.49
    )
    min_frame_share: float = setting(
        "smallest share of the frames whose points reach out to an edge of the box", ge=0.001, le=1
    )
    max_anchor_m: float = setting(
        "largest distance of such a face from where registration puts it; a farther one ends where something hides it",
        "m",
        ge=0,
        le=10,
    )
    anchor_window_s: float = setting(
        "length of the window, about each frame, in which the faces turned to the sensor correct the registration",
        "s",
        ge=0,
        le=3600,
    )


@dataclass(frozen=True)
class HeadingConfig(Config):
    """Heading of the boxes of a track."""

    min_speed_mps: float = setting(
        "speed from which the direction of motion gives the heading; below, it is held or taken from the shape",
        "m/s",
        ge=0,
        le=200,
    )
    min_moving_share: float = setting(
        "smallest share of the frames at that speed of what moves; with less, the object stands", ge=0, le=1
    )
    min_reach_m: float = setting(
        "distance from its first place that what moves gets to; a small object need not get so far",
        "m",
        ge=0,
        le=100,
    )
    min_reach_lengths: float = setting(
        "the same in multiples of the longer side that is seen of the object; the lesser of both is asked",
        ge=0,
        le=100,
    )
    min_reach_share: float = setting(
        "smallest ratio of that distance to the path from box to box; boxes of what stands go to and fro",
        ge=0,
        le=1,
    )
    low_vehicle_height_m: float = setting(
        "height up to which a parked object counts as a low vehicle", "m", ge=0, le=100
    )
    max_low_width_m: float = setting(
        "largest width of a low vehicle, with mirrors; a longer face is its side", "m", ge=0, le=100
    )
    max_high_width_m: float = setting(
        "largest width of any other vehicle, with mirrors; a longer face is its side", "m", ge=0, le=100
    )
    upper_share: float = setting(
        "share of the height from which on the points of a parked object belong to its upper part", ge=0, le=1
    )
    min_wheeled_width_m: float = setting(
        "width above which an object is no person or cyclist but a vehicle, longer than wide",
        "m",
        ge=0,
        le=100,
    )
    shoulder_width_m: float = setting(
        "largest extent of the upper part of a person; the face of one is not the end of a vehicle",
        "m",
        ge=0,
        le=10,
    )


@dataclass(frozen=True)
class KindSizeConfig(Config):
    """Sizes of one kind of road user, normally distributed."""

    share: float = setting("how frequent the kind is", ge=0, le=1)
    mean_lwh_m: tuple[float, ...] = setting("mean length, width and height", "m", gt=0, le=100)
    spread_lwh_m: tuple[float, ...] = setting(
        "standard deviation of length, width and height", "m", gt=0, le=100
    )
    max_speed_mps: float = setting(
        "speed above which an object is not of this kind; 0 for no limit", "m/s", ge=0, le=200
    )

    def __post_init__(self) -> None:
        for name in ("mean_lwh_m", "spread_lwh_m"):
            values = getattr(self, name)
            if len(values) != 3:
                raise BadSetting(
                    f"amodal: {name} = {list(values)} must be three numbers: length, width, height"
                )


@dataclass(frozen=True)
class SizePriorConfig(Config):
    """What is known of sizes where a side of an object is not seen, or not wholly."""

    min_shown_deg: float = setting(
        "angle between the line of sight and a side from which on the extent of the side shows",
        "degrees",
        ge=0,
        le=90,
    )
    whole_share_shown: float = setting(
        "how likely the extent that was seen of a side that shows is its whole extent", ge=0, le=1
    )
    whole_height_share: float = setting(
        "how likely the height that was seen is the whole one, where there are points enough", ge=0, le=1
    )
    whole_share_hidden: float = setting("the same of a side that does not show", ge=0, le=1)
    min_height_points: int = setting(
        "points in one frame from which on the whole height was seen: far away a few beams hit",
        ge=0,
        le=10**6,
    )
    shortfall_share: float = setting(
        "share of the whole length or width by which points fall short of it: edges are round", ge=0, le=0.5
    )
    extent_error_m: float = setting("standard deviation of that, plus a share of the side", "m", gt=0, le=10)
    extent_error_share: float = setting("that share", ge=0, le=0.5)
    other_share: float = setting("how frequent objects are that are of no kind", gt=0, le=1)
    other_volume_m3: float = setting(
        "volume of length x width x height over which the sizes of such objects are spread evenly",
        "m^3",
        gt=0,
        le=10**6,
    )
    car: KindSizeConfig = table("cars, wagons and small vans")
    van: KindSizeConfig = table("large vans and pickup trucks")
    truck: KindSizeConfig = table("trucks")
    bus: KindSizeConfig = table("buses")
    two_wheeler: KindSizeConfig = table("cyclists and motorcyclists with their vehicle")
    pedestrian: KindSizeConfig = table("adults")
    child: KindSizeConfig = table("children")

    @property
    def kinds(self) -> tuple[KindSizeConfig, ...]:
        """All kinds."""
        return (self.car, self.van, self.truck, self.bus, self.two_wheeler, self.pedestrian, self.child)


@dataclass(frozen=True)
class AmodalGroundConfig(Config):
    """How boxes stand on the ground."""

    ground_clearance_m: float = setting(
        "height below which points, of the ground or a kerb, do not count for length and width",
        "m",
        ge=0,
        le=10,
    )
    percentile: float = setting(
        "percentile over time of the ground heights below a track that its boxes stand on", "%", ge=0, le=100
    )
    window_s: float = setting(
        "length of the window, about each frame, in which that percentile is taken", "s", ge=0, le=3600
    )
    min_window_frames: int = setting("fewest frames of that window, the nearest in time", ge=1, le=10_000)
    max_standing_m: float = setting(
        "height of its lowest points below which an object stands on the ground in all frames",
        "m",
        ge=0,
        le=100,
    )


@dataclass(frozen=True)
class AmodalFitConfig(Config):
    """How the boxes of a track are fitted."""

    registration: TrackRegistrationConfig = table("registration of the clouds of a track")
    edges: EdgeConfig = table("where the points of an object end")
    heading: HeadingConfig = table("heading of the boxes")
    size: SizePriorConfig = table("sizes of objects of which a side is not seen")
    ground: AmodalGroundConfig = table("how boxes stand on the ground")
