"""Settings of the fit of amodal boxes."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting, table
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


@dataclass(frozen=True)
class HeadingConfig(Config):
    """Heading of the boxes of a track."""

    min_speed_mps: float = setting(
        "speed from which the direction of motion gives the heading; below, it is held or taken from the shape",
        "m/s",
        ge=0,
        le=200,
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
    shoulder_width_m: float = setting(
        "largest extent of the upper part of a person; the face of one is not the end of a vehicle",
        "m",
        ge=0,
        le=10,
    )


@dataclass(frozen=True)
class SizeCompletionConfig(Config):
    """What is known of sizes where a side of an object is never seen."""

    min_wheeled_width_m: float = setting(
        "width above which an object is no person or cyclist but a vehicle, longer than wide",
        "m",
        ge=0,
        le=100,
    )
    min_car_length_m: float = setting(
        "length above which an object is longer than any bicycle, so a vehicle", "m", ge=0, le=100
    )
    car_length_m: float = setting("smallest completed length of a vehicle", "m", ge=0, le=100)
    car_width_m: float = setting("smallest completed width of a vehicle", "m", ge=0, le=100)
    min_aspect: float = setting("smallest ratio of completed length to width of a vehicle", ge=1, le=100)
    person_length_m: float = setting("smallest completed length of an adult", "m", ge=0, le=10)
    person_width_m: float = setting("smallest completed width of an adult", "m", ge=0, le=10)
    person_height_m: float = setting(
        "height of an adult; what is lower has proportionally less length and width", "m", gt=0, le=10
    )
    min_person_height_m: float = setting(
        "height from which an object is completed as a person", "m", ge=0, le=10
    )
    max_person_height_m: float = setting(
        "height up to which an object is completed as a person, or a rider", "m", ge=0, le=10
    )


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
    window_frames: int = setting("frames of the window in which that percentile is taken", ge=1, le=10_000)
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
    size: SizeCompletionConfig = table("sizes of vehicles and persons of which a side is not seen")
    ground: AmodalGroundConfig = table("how boxes stand on the ground")
