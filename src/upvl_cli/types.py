"""What a drive is made of: frozen dataclasses of parallel arrays, and what datasets and models offer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt

from upvl_cli.errors import BadInput

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.floating[Any]]
Ints = npt.NDArray[np.integer[Any]]
Bools = npt.NDArray[np.bool_]


def array(dtype: str, *shape: int) -> Any:
    """Declare a field that holds one item of `shape` for each of the n items of its dataclass."""
    return field(metadata={"dtype": dtype, "shape": shape})


@dataclass(frozen=True)
class ParallelArrays:
    """Arrays of equal length; indexing selects the same things from each of them."""

    def __post_init__(self) -> None:
        lengths = {}
        for spec in fields(self):
            values = np.asarray(getattr(self, spec.name), dtype=spec.metadata["dtype"])
            shape = spec.metadata["shape"]
            if values.size == 0 and values.ndim <= 1:
                values = values.reshape(0, *shape)
            if values.shape[1:] != shape or values.ndim == 0:
                raise BadInput(
                    f"{type(self).__name__}.{spec.name} has shape {values.shape}, expected {('n', *shape)}"
                )
            lengths[spec.name] = len(values)
            object.__setattr__(self, spec.name, values)
        if len(set(lengths.values())) > 1:
            raise BadInput(f"{type(self).__name__} has arrays of different lengths: {lengths}")

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def __getitem__(self, index: Any) -> Self:
        return type(self)(**{spec.name: getattr(self, spec.name)[index] for spec in fields(self)})


@dataclass(frozen=True)
class Frame:
    """One time step of a segment.

    Attributes:
        index: Number of the frame in its segment; numbers can have gaps.
        time_ns: Time of the sweep, in nanoseconds from any fixed origin.
    """

    index: int
    time_ns: int


@dataclass(frozen=True)
class Points(ParallelArrays):
    """One LiDAR sweep in ego axes (x forward, y left, z up), motion-compensated to the frame's time.

    Attributes:
        xyz_ego_m: (n, 3) positions.
        intensity: (n,) strength of the return, 0 to 1 as the sensor gives it.
        elongation: (n,) width of the return's pulse; 0 where the sensor gives none.
        sensor: (n,) number of the LiDAR that saw the point.
        time_offset_ns: (n,) time of the point after the frame's time; 0 where unknown.
    """

    xyz_ego_m: Array = array("float32", 3)
    intensity: Array = array("float32")
    elongation: Array = array("float32")
    sensor: Array = array("uint8")
    time_offset_ns: Array = array("int64")


@dataclass(frozen=True)
class Camera:
    """A calibrated camera, in the axes of computer vision: x right, y down, z along the view.

    Attributes:
        name: Name that the dataset uses.
        width_px: Width of its images.
        height_px: Height of its images.
        intrinsic: (3, 3) pinhole matrix, in pixels; (0, 0) is the centre of the first pixel.
        distortion: k1, k2, p1, p2, k3 of the model "brown", or k1 to k4 of "fisheye".
        ego_from_camera: (4, 4) pose of the camera on the car.
        distortion_model: Which one (`geometry.lens`); a fisheye is used up to 90 degrees off its axis.
    """

    name: str
    width_px: int
    height_px: int
    intrinsic: Array
    distortion: Array
    ego_from_camera: Array
    distortion_model: Literal["brown", "fisheye"] = "brown"

    def __post_init__(self) -> None:
        numbers = (4,) if self.distortion_model == "fisheye" else (5,)
        for name, shape in (("intrinsic", (3, 3)), ("distortion", numbers), ("ego_from_camera", (4, 4))):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if values.shape != shape or not np.isfinite(values).all():
                raise BadInput(f"camera {self.name}: {name} must be finite and of shape {shape}")
            object.__setattr__(self, name, values)


@dataclass(frozen=True)
class Image:
    """One picture: (height, width, 3) uint8 `rgb`, taken at `time_ns`."""

    rgb: Array
    time_ns: int


@dataclass(frozen=True)
class Boxes(ParallelArrays):
    """Upright 3D boxes, in the axes that their owner says.

    Attributes:
        center_m: (n, 3) x, y, z of the centres.
        size_lwh_m: (n, 3) length, width and height.
        heading_rad: (n,) direction of the length, counter-clockwise from x.
    """

    center_m: Array = array("float64", 3)
    size_lwh_m: Array = array("float64", 3)
    heading_rad: Array = array("float64")

    @classmethod
    def from_rows(cls, rows: Array, **others: Array) -> Self:
        """Return boxes from (n, 7) rows of x, y, z, length, width, height (m), heading (rad).

        Args:
            rows: (n, 7) boxes, or nothing at all.
            others: The further arrays of a class with more of them.

        Raises:
            BadInput: The shape is another one.
        """
        rows = np.asarray(rows, dtype=np.float64)
        rows = rows.reshape(0, 7) if rows.size == 0 else rows
        if rows.ndim != 2 or rows.shape[1] != 7:
            raise BadInput(f"boxes have shape {rows.shape}, expected (n, 7): x, y, z, l, w, h, heading")
        return cls(center_m=rows[:, :3], size_lwh_m=rows[:, 3:6], heading_rad=rows[:, 6], **others)

    def to_rows(self) -> Array:
        """Return (n, 7) rows of x, y, z, length, width, height (m), heading (rad)."""
        return np.column_stack([self.center_m, self.size_lwh_m, self.heading_rad])


@dataclass(frozen=True)
class TrackedBoxes(Boxes):
    """Boxes of one frame in its ego axes, for example auto labels or detections.

    Attributes:
        velocity_mps: (n, 3) velocity over the ground along the ego axes.
        score: (n,) confidence, 0 to 1.
        track_id: (n,) number of the track, -1 for none.
    """

    velocity_mps: Array = array("float64", 3)
    score: Array = array("float64")
    track_id: Array = array("int64")


@dataclass(frozen=True)
class Boxes2d(ParallelArrays):
    """Boxes in one picture: (n, 4) left, top, right, bottom in pixels as of `Camera`; scores 0 to 1; names."""

    xyxy_px: Array = array("float64", 4)
    score: Array = array("float64")
    name: Array = array("str")


@dataclass(frozen=True)
class Labels(Boxes):
    """Human (or simulated) boxes of a whole segment, each in the ego axes of its frame; for evaluation only.

    Attributes:
        frame: (n,) index of the frame.
        object_id: (n,) which object; the same in all frames.
        class_name: (n,) the dataset's own name of the class, for example "Car".
        type: (n,) VEHICLE 1, PEDESTRIAN 2, SIGN 3, CYCLIST 4; 0 for anything else (Waymo's numbers).
        velocity_mps: (n, 3) over the ground along the ego axes; NaN where the dataset gives none.
        num_points: (n,) LiDAR points inside the box; -1 where the dataset gives none.
        difficulty: (n,) 1 or 2 as the dataset says; 0 where it says nothing.
    """

    frame: Array = array("int64")
    object_id: Array = array("str")
    class_name: Array = array("str")
    type: Array = array("int8")
    velocity_mps: Array = array("float64", 3)
    num_points: Array = array("int64")
    difficulty: Array = array("int8")


@dataclass(frozen=True)
class Ragged:
    """For each of n things any number of items.

    `values` (m, ...) has the items of the first thing, then those of the second; `count` (n,) how many each has.
    """

    values: Array
    count: Ints

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", np.asarray(self.values))
        object.__setattr__(self, "count", np.asarray(self.count, dtype=np.int64))
        if self.count.ndim != 1 or self.count.sum() != len(self.values):
            raise BadInput(f"{len(self.values)} items for counts that add up to {self.count.sum()}")

    @property
    def owner(self) -> Ints:
        """(m,) the thing that each item belongs to, ascending."""
        return np.repeat(np.arange(len(self.count)), self.count)

    @classmethod
    def grouped(cls, owner: Ints, values: Array, total: int) -> Self:
        """Return items under their owners; within an owner they keep their order.

        Args:
            owner: (k,) the thing of each item, -1 for one that belongs to none and is left out.
            values: (k, ...) the items.
            total: How many things there are.
        """
        order = np.argsort(owner, kind="stable")
        order = order[np.searchsorted(owner[order], 0) :]
        return cls(np.asarray(values)[order], np.bincount(owner[order], minlength=total))


T = TypeVar("T", bound=ParallelArrays)


def concat(parts: Sequence[T], kind: type[T]) -> T:
    """Return the things of all parts, one part after the other; none of that kind where there is no part."""
    columns = {spec.name: [getattr(part, spec.name) for part in parts] for spec in fields(kind)}
    return (
        kind(**{name: np.concatenate(values) for name, values in columns.items()}) if parts else empty(kind)
    )


def empty(kind: type[T]) -> T:
    """Return none of the things of that kind."""
    return kind(**{spec.name: np.zeros((0, *spec.metadata["shape"])) for spec in fields(kind)})


class Drive(Protocol):
    """One segment, read in place."""

    @property
    def name(self) -> str:
        """Name of the segment; letters, digits, `.`, `_` and `-` only."""

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The frames that can be read, in ascending order of index and time."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The calibrated cameras; empty where there is none."""

    @property
    def skipped(self) -> Mapping[str, int]:
        """How many frames or images were left out, by reason."""

    @property
    def ground_z_m(self) -> float:
        """Height of the road below the car in ego axes, roughly: a start for the ground search."""

    @property
    def world_from_ego(self) -> Array | None:
        """(T, 4, 4) pose of each of `frames`, or None where the dataset has none."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that can be read: what makes a shard older than its drive."""

    def points(self, frame: int) -> Points:
        """Return the sweep of the frame of that index."""

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of that camera, or None where it is missing."""


class Dataset(Protocol):
    """A folder of drives, or a maker of them. Human labels are no part of it: see `datasets.labels`."""

    @property
    def version(self) -> int:
        """Raised by hand when the adapter gives other points for equal files: part of every stamp."""

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of all segments, sorted."""

    @property
    def fingerprint_values(self) -> Mapping[str, Any]:
        """Settings of its own that make a drive what it is: part of every stamp; empty where files say it all."""

    def open(self, segment: str) -> Drive:
        """Return the drive of that name; raises `BadInput` where it cannot be read."""


@dataclass(frozen=True)
class BackgroundRule:
    """When a feature counts as background: the cosine scale belongs to the model (UP-VL, Section 3.2).

    A point is background where max cos(f, background words) - max cos(f, `against`) >= `threshold`;
    without words to compare with that is the paper's own rule, cos >= eps_bg, on the scale of this model.
    """

    against: tuple[str, ...]
    threshold: float


class Model(Protocol):
    """A vision-language model; its image network is loaded when the first picture is embedded."""

    @property
    def name(self) -> str:
        """Its name, for people."""

    @property
    def dim(self) -> int:
        """Length d of its vectors."""

    @property
    def background(self) -> BackgroundRule:
        """Its own calibrated background rule."""

    def embed_text(self, words: Sequence[str]) -> Floats:
        """Return (t, d) float32 vectors of length 1, one a word or phrase."""

    def embed_image(self, rgb: Array) -> Floats:
        """Return (h', w', d) float32 dense features of an (h, w, 3) uint8 picture, of any length.

        The cells cover the picture evenly: pixel (u, v), whose centre is at (u + 0.5, v + 0.5) from the corner,
        lies in the cell coordinates ((u + 0.5) w' / w - 0.5, (v + 0.5) h' / h - 0.5).
        """
