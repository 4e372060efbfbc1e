"""Flow errors by hand, and on a real pair against the definition that comes with it."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from upvl_cli.errors import BadInput
from upvl_cli.metrics.flow import FlowBuckets, bucket_score, flow_buckets, flow_errors

# Two points of a moving car, one of a parked car, one of a wall; each moves along x.
TRUE_M = np.array([[1.0, 0, 0], [1.0, 0, 0], [0, 0, 0], [0, 0, 0]])
TRUTH: dict[str, Any] = {
    "true_total_m": TRUE_M - [2.0, 0, 0],  # the car drives 2 m forward
    "foreground": np.array([True, True, True, False]),
    "dynamic": np.array([True, True, False, False]),
    "evaluated": np.ones(4, dtype=bool),
}


def test_errors_by_hand() -> None:
    predicted_m = [[1.04, 0, 0], [0.7, 0.4, 0], [0.02, 0, 0], [0.06, 0, 0]]
    errors = flow_errors(predicted_m, TRUE_M, **TRUTH)
    assert errors.dynamic_epe_m == pytest.approx((0.04 + 0.5) / 2)
    assert errors.static_epe_m == pytest.approx(0.02)
    assert errors.background_epe_m == pytest.approx(0.06)
    assert errors.three_way_epe_m == pytest.approx((0.27 + 0.02 + 0.06) / 3)
    assert (errors.strict, errors.relaxed) == (0.5, 0.5)
    assert errors.dynamic_iou == pytest.approx(2 / 3)  # the wall is called moving
    assert errors.points == (2, 1, 1)


def test_accuracy_is_relative_to_the_total_flow() -> None:
    predicted_m = TRUE_M + [0.3, 0, 0]
    total_m = np.array([[4.0, 0, 0], [2.0, 0, 0], [0, 0, 0], [0, 0, 0]])
    errors = flow_errors(predicted_m, TRUE_M, **TRUTH | {"true_total_m": total_m})
    assert (errors.strict, errors.relaxed) == (0.0, 0.5)


def test_points_that_do_not_count_change_nothing() -> None:
    predicted_m = TRUE_M + [[0, 0, 0], [9, 9, 9], [0, 0, 0], [0, 0, 0]]
    errors = flow_errors(predicted_m, TRUE_M, **TRUTH | {"evaluated": [True, False, True, True]})
    assert errors.three_way_epe_m == 0
    assert (errors.strict, errors.dynamic_iou) == (1.0, 1.0)


def test_buckets_by_hand() -> None:
    # Class 0 stands; class 1 walks at 1 m/s and at 1.1 m/s (one bucket), and drives at 10 m/s and 30 m/s.
    true_m = np.array([[0, 0, 0], [0.1, 0, 0], [0.11, 0, 0], [1.0, 0, 0], [3.0, 0, 0], [5.0, 0, 0]])
    wrong_m = np.array([0.02, 0.1, 0.05, 0.5, 0.0, 7.0])
    predicted_m = true_m + wrong_m[:, None] * [0, 1, 0]
    group = [0, 1, 1, 1, 1, -1]
    score = bucket_score(flow_buckets(predicted_m, true_m, group=group, groups=3, interval_s=0.1))
    np.testing.assert_allclose(score.static_epe_m, [0.02, math.nan, math.nan])
    np.testing.assert_allclose(score.dynamic_error, [math.nan, (0.15 / 0.21 + 0.5 + 0) / 3, math.nan])
    assert score.mean_static_epe_m == pytest.approx(0.02)
    assert score.mean_dynamic_error == pytest.approx((0.15 / 0.21 + 0.5 + 0) / 3)
    assert np.flatnonzero(~np.isnan(score.by_speed[1])).tolist() == [2, 25, 50]


def test_no_motion_scores_one_and_longer_intervals_are_slower_speeds() -> None:
    true_m = np.random.default_rng(0).normal(0, 1, (500, 3))
    still = flow_buckets(np.zeros((500, 3)), true_m, group=np.zeros(500), groups=1, interval_s=0.1)
    assert bucket_score(still).mean_dynamic_error == pytest.approx(1)
    slow = flow_buckets(np.zeros((500, 3)), true_m, group=np.zeros(500), groups=1, interval_s=10.0)
    assert slow.count[0, :1].sum() == 500


def test_buckets_of_several_sweeps_add_up() -> None:
    rng = np.random.default_rng(0)
    true_m, predicted_m, group = (
        rng.normal(0, 1, (100, 3)),
        rng.normal(0, 1, (100, 3)),
        rng.integers(-1, 3, 100),
    )

    def of(part: slice) -> FlowBuckets:
        return flow_buckets(predicted_m[part], true_m[part], group=group[part], groups=3, interval_s=0.1)

    whole, halves = of(slice(None)), of(slice(0, 40)) + of(slice(40, None))
    np.testing.assert_array_equal(whole.count, halves.count)
    np.testing.assert_allclose(bucket_score(whole).by_speed, bucket_score(halves).by_speed)


def test_empty() -> None:
    nothing = np.zeros((0, 3))
    masks: dict[str, Any] = {name: np.zeros(0, dtype=bool) for name in ("foreground", "dynamic", "evaluated")}
    errors = flow_errors(nothing, nothing, true_total_m=nothing, **masks)
    assert math.isnan(errors.three_way_epe_m)
    assert math.isnan(errors.strict)
    assert (errors.dynamic_iou, errors.points) == (0.0, (0, 0, 0))
    score = bucket_score(flow_buckets(nothing, nothing, group=[], groups=2, interval_s=0.1))
    assert math.isnan(score.mean_dynamic_error)
    assert score.by_speed.shape == (2, 51)


def test_bad_predictions_are_refused_in_one_line() -> None:
    with pytest.raises(BadInput, match="^flow of 3 points against truth of 4"):
        flow_errors(TRUE_M[:3], TRUE_M, **TRUTH)
    broken = TRUE_M.copy()
    broken[2, 1] = math.nan
    with pytest.raises(BadInput, match="^flow of point 2 is not finite"):
        flow_buckets(broken, TRUE_M, group=[0] * 4, groups=1, interval_s=0.1)
    with pytest.raises(BadInput, match="^a point of class 2, expected 0 to 1"):
        flow_buckets(TRUE_M, TRUE_M, group=[0, 1, 2, -1], groups=2, interval_s=0.1)


def definition(folder: Path) -> Any:
    spec = importlib.util.spec_from_file_location("pair_metrics", folder / "metrics.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.real
@pytest.mark.parametrize("prediction", ["none", "shipped", "true", "noisy", "half"])
def test_a_real_pair_scores_as_its_own_definition_says(shared: Path, prediction: str) -> None:
    folder = shared / "data" / "flow_pair_a"
    pair = dict(np.load(folder / "pair.npz"))
    true_m = pair["gt_flow"]
    noise = np.random.default_rng(1).normal(0, 0.06, true_m.shape)
    predicted_m = {
        "none": true_m * 0,
        "shipped": pair["est_flow_shipped"],
        "true": true_m,
        "noisy": true_m + noise,
        "half": true_m / 2,
    }[prediction]
    expected = definition(folder).evaluate(pair, predicted_m)
    errors = flow_errors(
        predicted_m,
        true_m,
        true_total_m=pair["gt_flow_total"],
        foreground=pair["classes"] > 0,
        dynamic=pair["is_dynamic"],
        evaluated=pair["is_close"] & pair["is_valid"] & ~pair["is_ground"],
    )
    assert errors.three_way_epe_m == pytest.approx(expected["three_way"], abs=1e-12)
    assert errors.dynamic_epe_m == pytest.approx(expected["epe_fd"], abs=1e-12)
    assert errors.static_epe_m == pytest.approx(expected["epe_fs"], abs=1e-12)
    assert errors.background_epe_m == pytest.approx(expected["epe_bs"], abs=1e-12)
    assert (errors.strict, errors.relaxed) == (expected["acc_strict"], expected["acc_relax"])
    assert errors.dynamic_iou == expected["dyn_iou"]
    assert errors.points == tuple(expected["n"].values())
