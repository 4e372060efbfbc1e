"""The filter and its smoother are those of filterpy, and noise is what its law says."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import predict, rts_smoother, update
from tracker_settings import CONFIG

from upvl_cli.perception.tracking.motion_model import MotionModel, squared_distance
from upvl_cli.perception.tracking.motion_model import update as update_of_upvl
from upvl_cli.types import Boxes

MODEL = MotionModel(CONFIG)
RNG = np.random.default_rng(0)


def by_filterpy(
    time_s: np.ndarray, measured: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The filter's and the smoother's states and covariances."""
    states, covariances, transitions, drifts = [measured[0]], [noise[0]], [], []
    for dt_s, box, box_noise in zip(np.diff(time_s), measured[1:], noise[1:], strict=True):
        transition = np.eye(4)
        transition[0, 2] = transition[1, 3] = dt_s
        drift = Q_continuous_white_noise(
            2, dt_s, CONFIG.acceleration_psd_m2ps3, block_size=2, order_by_dim=False
        )
        state, covariance = predict(states[-1], covariances[-1], transition, drift)
        if np.isfinite(box).all():
            state, covariance = update(state, covariance, box, box_noise, np.eye(4))
        states.append(state)
        covariances.append(covariance)
        transitions.append(transition)
        drifts.append(drift)
    smooth = rts_smoother(np.array(states), np.array(covariances), transitions, drifts)
    return np.array(states), np.array(covariances), smooth[0], smooth[1]


def test_states_are_those_of_filterpys_filter_and_smoother() -> None:
    time_s = np.cumsum(RNG.uniform(0.05, 0.3, 25))
    measured = RNG.normal(0, 3, (25, 4))
    noise = MODEL.noise(Boxes.from_rows(np.abs(RNG.normal(2, 1, (25, 7)))))
    measured[[4, 5, 9]] = np.nan
    states, covariances = MODEL.filter(time_s, measured, noise)
    filtered, _, smooth, smooth_covariances = by_filterpy(time_s, measured, noise)
    np.testing.assert_allclose(states, smooth, atol=1e-9)
    np.testing.assert_allclose(covariances, smooth_covariances, atol=1e-9)
    assert np.abs(states - filtered)[:-1].max() > 0.1, "the smoother changes what the filter found"


def test_one_measurement_is_its_own_state() -> None:
    measured, noise = RNG.normal(size=(1, 4)), MODEL.noise(Boxes.from_rows(np.ones((1, 7))))
    states, covariances = MODEL.filter(np.zeros(1), measured, noise)
    np.testing.assert_array_equal(states, measured)
    np.testing.assert_array_equal(covariances, noise)


def test_states_of_many_objects_are_moved_and_corrected_as_each_alone() -> None:
    state, measured, dt_s = RNG.normal(size=(3, 4)), RNG.normal(size=(3, 4)), np.array([0.1, 0.4, 0.0])
    noise = MODEL.noise(Boxes.from_rows(np.abs(RNG.normal(2, 1, (3, 7)))))
    moved, covariance = MODEL.predict(state, noise, dt_s)
    better, surer = update_of_upvl(moved, covariance, measured, noise)
    for one in range(3):
        alone = MODEL.predict(state[one], noise[one], dt_s[one])
        np.testing.assert_array_equal(moved[one], alone[0])
        np.testing.assert_array_equal(covariance[one], alone[1])
        corrected = update_of_upvl(*alone, measured[one], noise[one])
        np.testing.assert_array_equal(better[one], corrected[0])
        np.testing.assert_array_equal(surer[one], corrected[1])


def test_process_noise_grows_with_time_whatever_the_frame_rate() -> None:
    """Two steps leave as much uncertainty as one of the same duration."""
    state, covariance = np.array([1.0, 2.0, 3.0, 4.0]), np.zeros((4, 4))
    at_once = MODEL.predict(state, covariance, 0.5)
    in_steps = MODEL.predict(*MODEL.predict(state, covariance, 0.2), 0.3)
    np.testing.assert_allclose(in_steps[0], at_once[0], atol=1e-12)
    np.testing.assert_allclose(in_steps[1], at_once[1], atol=1e-12)
    np.testing.assert_allclose(at_once[0], [2.5, 4.0, 3.0, 4.0])
    # The variance of a velocity is the spectral density times the time.
    assert at_once[1][2, 2] == pytest.approx(CONFIG.acceleration_psd_m2ps3 * 0.5)
    assert at_once[1][1, 1] == pytest.approx(CONFIG.acceleration_psd_m2ps3 * 0.5**3 / 3)


@pytest.mark.parametrize(("heading_rad", "along"), [(0.0, [1.0, 0.0]), (np.pi / 2, [0.0, 1.0]), (0.7, None)])
def test_a_center_is_less_sure_along_the_longer_side(heading_rad: float, along: list[float] | None) -> None:
    noise = MODEL.noise(Boxes.from_rows(np.array([[0, 0, 0, 5.0, 2.0, 1.5, heading_rad]])))[0]
    way = np.array(along or [np.cos(heading_rad), np.sin(heading_rad)])
    aside = np.array([-way[1], way[0]])
    # 0.2 m, and a tenth of 5 m or 2 m.
    assert way @ noise[:2, :2] @ way == pytest.approx(0.2**2 + 0.5**2)
    assert aside @ noise[:2, :2] @ aside == pytest.approx(0.2**2 + 0.2**2)
    assert way @ noise[:2, :2] @ aside == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(noise[2:, 2:], np.eye(2) * 0.7**2)
    assert not noise[:2, 2:].any()
    assert not noise[2:, :2].any()


def test_the_squared_distance_is_mahalanobis() -> None:
    root = RNG.normal(size=(3, 5, 4, 4))
    covariance, offset = root @ root.swapaxes(-1, -2) + np.eye(4), RNG.normal(size=(3, 5, 4))
    expected = np.einsum("abi,abij,abj->ab", offset, np.linalg.inv(covariance), offset)
    np.testing.assert_allclose(squared_distance(offset, covariance), expected, rtol=1e-9)
    assert squared_distance(np.array([3.0, 4.0]), np.diag([9.0, 4.0])) == pytest.approx(1 + 4)
