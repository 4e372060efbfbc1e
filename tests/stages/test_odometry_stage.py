"""The stage `odometry`: poses given, estimated or refined, measured by the sweeps, and what is counted."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from memory_inputs import MemoryInputs

from perception.still_scene import SETTINGS, gentle_bend, points_at
from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.stages import odometry
from upvl_cli.stages.rows import OdometryRow
from upvl_cli.types import Frame, Points

TIME_S = np.arange(6) / 10
TRUE = np.array([gentle_bend(20.0)(time_s) for time_s in TIME_S.tolist()])


@dataclass
class StillDrive:
    """The still scene as a drive; each pose can be another one than the sweep was taken from."""

    world_from_ego: np.ndarray | None
    broken: int | None = None  # a frame of which nothing is seen
    skipped: dict[str, int] = field(default_factory=dict)

    @property
    def frames(self) -> list[Frame]:
        return [Frame(number, 10**18 + round(time_s * 1e9)) for number, time_s in enumerate(TIME_S.tolist())]

    def points(self, frame: int) -> Points:
        xyz = points_at(TRUE[frame], frame)[: 0 if frame == self.broken else None]
        zeros = np.zeros(len(xyz))
        return Points(xyz, zeros, zeros, zeros, zeros)


def rows_of(drive: StillDrive, poses: str) -> tuple[list[OdometryRow], dict[str, int]]:
    inputs = MemoryInputs({}, drive)  # type: ignore[arg-type]
    rows = list(odometry.run(inputs, replace(SETTINGS, poses=poses)))  # type: ignore[arg-type]
    return rows, dict(inputs.counts)


def column(rows: list[OdometryRow], name: str) -> np.ndarray:
    return np.array([getattr(row, name) for row in rows])


def steps_m(rows: list[OdometryRow]) -> np.ndarray:
    poses = column(rows, "world_from_ego")
    return np.asarray(compose(inverse(poses[:-1]), poses[1:])[:, :3, 3])


def test_given_poses_pass_through_with_their_residual() -> None:
    rows, counts = rows_of(StillDrive(TRUE), "given")
    np.testing.assert_array_equal(column(rows, "world_from_ego"), TRUE)
    assert counts["poses given"] == 6
    assert np.isnan(rows[0].residual_m)
    assert (column(rows, "residual_m")[1:] < 0.1).all()
    assert (column(rows, "inlier_share")[1:] > 0.85).all()
    assert (column(rows, "position_sigma_m")[1:] < 0.03).all()
    np.testing.assert_array_equal(column(rows, "residual_given_m"), column(rows, "residual_m"))


def test_poses_that_are_wrong_have_few_partners() -> None:
    mirrored = TRUE.copy()
    mirrored[:, 0, 3] *= -1
    rows, _ = rows_of(StillDrive(mirrored), "given")
    assert (column(rows, "inlier_share")[1:] < 0.7).all()


@pytest.mark.parametrize(("given", "poses"), [(None, "given"), (None, "refined"), (TRUE, "estimated")])
def test_the_sweeps_give_the_poses_where_there_are_none_or_by_wish(
    given: np.ndarray | None, poses: str
) -> None:
    rows, counts = rows_of(StillDrive(given), poses)
    expected = compose(inverse(TRUE[0]), TRUE)
    np.testing.assert_allclose(column(rows, "world_from_ego")[:, :3, 3], expected[:, :3, 3], atol=0.1)
    assert counts["poses estimated"] == 6
    assert np.isnan(column(rows, "residual_given_m")).all()


def test_rough_poses_are_refined_and_both_residuals_are_told() -> None:
    rough = TRUE.copy()
    rough[:, :2, 3] = np.round(rough[:, :2, 3] / 1.1) * 1.1
    rows, counts = rows_of(StillDrive(rough), "refined")
    assert counts["poses refined"] == 6
    assert counts["poses that the sweeps agree with better than with the given ones"] >= 3
    true_steps = compose(inverse(TRUE[:-1]), TRUE[1:])[:, :3, 3]
    assert np.abs(steps_m(rows) - true_steps).max() < 0.1
    assert np.nanmean(column(rows, "residual_m")) < 0.7 * np.nanmean(column(rows, "residual_given_m"))
    assert np.nanmean(column(rows, "inlier_share")) > np.nanmean(column(rows, "inlier_share_given"))


def test_given_poses_of_another_shape_are_told() -> None:
    _, counts = rows_of(StillDrive(np.tile(TRUE[:1], (6, 1, 1))), "refined")
    assert counts["given poses whose shape the sweeps contradict: it was not used"] == 6


def test_a_frame_that_cannot_be_placed_is_counted_and_marked() -> None:
    rows, counts = rows_of(StillDrive(None, broken=3), "given")
    assert counts["frames that could not be placed, poses interpolated"] == 1
    assert column(rows, "is_placed").tolist() == [True, True, True, False, True, True]
    np.testing.assert_allclose(rows[3].world_from_ego[:2, 3], TRUE[3, :2, 3], atol=0.1)


def test_threads_change_no_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for threads in ("1", "2"):
        monkeypatch.setenv("UPVL_THREADS", threads)
        rows, _ = rows_of(StillDrive(None), "estimated")
        found.append(
            [(row.world_from_ego.tobytes(), row.residual_m, row.position_sigma_m) for row in rows[1:]]
        )
    assert found[0] == found[1]
