"""Flow that another program has estimated, as velocity over the ground."""

from __future__ import annotations

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply
from upvl_cli.perception.flow.stored_config import StoredFlowConfig
from upvl_cli.types import Array, Floats

MAX_SPEED_MPS = 1000.0  # beyond every vehicle: the unit is another one, and half precision ends at 65 504


def check_stored_flow(flow: Array, total: int, where: str) -> Floats:
    """Return the array of a file as (n, 3) float64.

    Args:
        flow: What the file holds.
        total: Number n of points of the sweep.
        where: The file, for messages.

    Raises:
        BadInput: The shape or the type is another one, or a number is not finite.
    """
    if flow.shape != (total, 3) or flow.dtype.kind not in "fiu":
        raise BadInput(
            f"{where} has shape {flow.shape} of {flow.dtype}, expected ({total}, 3) numbers: one flow for each point "
            "of the sweep, in its order"
        )
    values = flow.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise BadInput(
            f"{where}: the flow of {len(bad)} points is not finite, the first is point {bad[0]}; write 0 where none "
            "is known"
        )
    return np.asarray(values)


def velocity_over_ground(
    flow: Floats, xyz_ego_m: Floats, ego_from_other: Array, dt_s: float, config: StoredFlowConfig
) -> Floats:
    """Return the (n, 3) velocity over the ground of each point in m/s, along the ego axes of its sweep.

    Args:
        flow: (n, 3) numbers as `config` declares them.
        xyz_ego_m: (n, 3) points of the sweep.
        ego_from_other: (4, 4) pose of the other sweep's ego axes in those of this one.
        dt_s: Time to the other sweep; negative where it came before.
        config: Unit and meaning of the numbers.
    """
    shift_m = flow * dt_s if config.unit == "m/s" else flow
    if config.ego_motion == "included":
        shift_m = apply(ego_from_other, xyz_ego_m + shift_m) - xyz_ego_m
    return np.asarray(shift_m / dt_s)


def check_speed(flow_mps: Floats, where: str) -> None:
    """Refuse flow faster than anything on a road.

    Raises:
        BadInput: A point is; the message names the setting that is likely wrong.
    """
    fastest_mps = float(np.abs(flow_mps).max(initial=0))
    if fastest_mps > MAX_SPEED_MPS:
        raise BadInput(
            f"{where} has a point at {fastest_mps:.4g} m/s, expected at most {MAX_SPEED_MPS:g}; see unit and "
            "ego_motion in [file] of flow.toml"
        )
