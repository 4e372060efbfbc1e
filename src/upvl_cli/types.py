"""What a drive is made of: frozen dataclasses of parallel arrays, checked once, on construction."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from upvl_cli.errors import BadInput

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.floating[Any]]
Ints = npt.NDArray[np.integer[Any]]
Bools = npt.NDArray[np.bool_]


def array(dtype: str, *shape: int) -> Any:
    """A field that holds one item of `shape` for each of the n things of its dataclass."""
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
        distortion: (5,) k1, k2, p1, p2, k3 of the Brown-Conrady model.
        ego_from_camera: (4, 4) pose of the camera on the car.
    """

    name: str
    width_px: int
    height_px: int
    intrinsic: Array
    distortion: Array
    ego_from_camera: Array

    def __post_init__(self) -> None:
        for name, shape in (("intrinsic", (3, 3)), ("distortion", (5,)), ("ego_from_camera", (4, 4))):
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
    """Upright 3D boxes of one frame in its ego axes, for example auto labels or detections.

    Attributes:
        seven: (n, 7) x, y, z of the centre, length, width, height (m), heading (rad, counter-clockwise
            from x): the paper's seven.
        velocity_mps: (n, 3) speed over the ground along the ego axes.
        score: (n,) confidence, 0 to 1.
        track_id: (n,) number of the track, -1 for none.
    """

    seven: Array = array("float64", 7)
    velocity_mps: Array = array("float64", 3)
    score: Array = array("float64")
    track_id: Array = array("int64")


@dataclass(frozen=True)
class Labels(ParallelArrays):
    """Human (or simulated) boxes of a whole segment, for evaluation only.

    Attributes:
        frame: (n,) index of the frame.
        seven: (n, 7) boxes in the ego axes of that frame, as in `Boxes`.
        object_id: (n,) which object; the same in all frames.
        kind: (n,) the dataset's own name of the kind, for example "Car".
        type: (n,) VEHICLE 1, PEDESTRIAN 2, SIGN 3, CYCLIST 4; 0 for anything else (Waymo's numbers).
        velocity_mps: (n, 3) over the ground along the ego axes; NaN where the dataset gives none.
        points: (n,) LiDAR points inside the box; -1 where the dataset gives none.
        difficulty: (n,) 1 or 2 as the dataset says; 0 where it says nothing.
    """

    frame: Array = array("int64")
    seven: Array = array("float64", 7)
    object_id: Array = array("str")
    kind: Array = array("str")
    type: Array = array("int8")
    velocity_mps: Array = array("float64", 3)
    points: Array = array("int64")
    difficulty: Array = array("int8")
