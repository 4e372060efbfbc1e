"""Things of the made-up street go where their numbers say."""

from __future__ import annotations

import numpy as np
import pytest

from world.scene import BOX, Ground, Motion, Part, Pose, Scene, Thing, solids_at

FLAT = Ground(y_m=(-9.0, 9.0), z_m=(0.0, 0.0), materials=("asphalt",), grade=0.0)


@pytest.mark.parametrize(
    ("motion", "time_s", "expected"),
    [
        pytest.param(Motion(Pose(1, 2, 0.5)), 9.0, (1, 2, 0.5), id="rests"),
        pytest.param(Motion(Pose(0, 0, 0), 3.0), 2.0, (6, 0, 0), id="straight"),
        pytest.param(Motion(Pose(0, 0, np.pi / 2), 3.0), 2.0, (0, 6, np.pi / 2), id="to the left"),
        pytest.param(Motion(Pose(0, 0, 0), 8.0, 2.0), 2.0, (12, 0, 0), id="brakes"),
        pytest.param(Motion(Pose(0, 0, 0), 8.0, 2.0), 99.0, (16, 0, 0), id="stands after 4 s"),
        pytest.param(
            Motion(Pose(0, 0, 0), 5.0, 0, 1.0, 2.0), 1.0, (5, 0.5, np.arctan2(0.75, 5)), id="half a step"
        ),
        pytest.param(Motion(Pose(0, 0, 0), 5.0, 0, 1.0, 2.0), 4.0, (20, 1, 0), id="after the step"),
    ],
)
def test_a_motion_goes_where_its_numbers_say(motion, time_s, expected):
    np.testing.assert_allclose(motion.at(time_s), expected, atol=1e-12)


def test_a_thing_looks_where_it_goes():
    motion = Motion(Pose(3, 4, 2.0), 8.0, 1.5, 0.6, 2.0)
    for time_s in (0.0, 0.4, 1.1, 1.9, 2.5):
        before, after = (np.array(motion.at(time_s + step)) for step in (-1e-6, 1e-6))
        direction = np.arctan2(after[1] - before[1], after[0] - before[0])
        assert motion.at(time_s).heading_rad == pytest.approx(direction, abs=1e-5)


def test_the_ground_rises_at_the_kerb_and_along_the_street():
    ground = Ground(
        y_m=(-2, 0, 1, 5), z_m=(0, 0, 0.1, 0.1), materials=("asphalt", "kerb", "pavement"), grade=0.01
    )
    np.testing.assert_allclose(ground.height_m([0, 0, 100, 100], [-1, 0.5, -1, 3]), [0, 0.05, 1, 1.1])


def test_parts_turn_with_their_thing_and_swing():
    part = Part(BOX, (1.0, 0.0, 0.5), (2.0, 1.0, 1.0), "red", swing_m=0.2)
    scene = Scene(
        FLAT, (Thing("Car", (2, 1, 1), Motion(Pose(0, 3, np.pi / 2)), (part,)),), Motion(Pose(0, 0, 0))
    )
    np.testing.assert_allclose(solids_at(scene, 0.0).centre_m, [[0, 4, 0.5]], atol=1e-12)
    np.testing.assert_allclose(solids_at(scene, 0.25).centre_m, [[0, 4.2, 0.5]], atol=1e-12)
    np.testing.assert_allclose(solids_at(scene, 0.0).half_m, [[1, 0.5, 0.5]])


def test_a_scene_without_things_has_no_solids():
    assert len(solids_at(Scene(FLAT, (), Motion(Pose(0, 0, 0))), 1.0)) == 0
