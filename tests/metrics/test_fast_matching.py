"""Detection and tracking at all cut-offs against the plain rules, one cut-off at a time."""

from __future__ import annotations

import numpy as np
import pytest
from plain_scores import plain_detection, plain_tracking, scipy_hungarian, score_first, ties_as_official
from streets import random_street

from upvl_cli.metrics.waymo.breakdown import BREAKDOWNS, moving_objects
from upvl_cli.metrics.waymo.detection import detection
from upvl_cli.metrics.waymo.official import Matcher
from upvl_cli.metrics.waymo.pairing import pair_frames
from upvl_cli.metrics.waymo.speeds import estimate_speeds
from upvl_cli.metrics.waymo.tracking import tracking

CUTOFFS = np.array([0.0, 0.1, 0.25, 0.5, 0.51, 0.8, 1.0], dtype=np.float32)
SPLITS = [BREAKDOWNS[name] for name in ("OBJECT_TYPE", "RANGE", "SIZE", "VELOCITY")]
STREETS = {
    "open": {"frames": 6, "objects": 12, "side_m": 30},
    "crowded": {"frames": 4, "objects": 20, "side_m": 5},
    "on a grid": {"frames": 4, "objects": 16, "side_m": 6, "grid_m": 1.0},
}


@pytest.mark.parametrize("threshold", [0.1, 0.5])
@pytest.mark.parametrize("name", STREETS)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("matcher", ["hungarian", "score_first"])
def test_detection_equals_the_plain_rules(name: str, seed: int, threshold: float, matcher: Matcher) -> None:
    truth, predictions = random_street(seed, **STREETS[name])
    rule = {"iou_thresholds": [0.0, threshold, threshold, 0.3, threshold], "score_cutoffs": CUTOFFS}
    hungarian = ties_as_official if name == "on a grid" else scipy_hungarian
    solve = hungarian if matcher == "hungarian" else score_first
    for split in [*SPLITS, moving_objects(min_speed_mps=1.0)]:
        fast = detection(truth, predictions, **rule, breakdowns=[split], matcher=matcher)
        plain = plain_detection(truth, predictions, rule["iou_thresholds"], split, CUTOFFS, solve)
        for result, (shard, level) in zip(fast, np.ndindex(len(split.shards), 2), strict=True):
            for count in ("tp", "fp", "fn"):
                np.testing.assert_array_equal(getattr(result, count), plain[count][level, shard], result.name)
            np.testing.assert_allclose(result.sum_ha, plain["ha"][level, shard], rtol=1e-5)


@pytest.mark.parametrize("threshold", [0.1, 0.5])
@pytest.mark.parametrize("name", ["open", "crowded"])
@pytest.mark.parametrize("seed", range(2))
def test_tracking_equals_the_plain_rules(name: str, seed: int, threshold: float) -> None:
    truth, predictions = random_street(seed, **STREETS[name])
    thresholds = [0.0, threshold, threshold, 0.3, threshold]
    fast = tracking(
        *(truth, predictions),
        iou_thresholds=thresholds,
        breakdowns=SPLITS,
        score_cutoffs=CUTOFFS,
        matcher="hungarian",
    )
    guessed = estimate_speeds(pairing := pair_frames(truth, predictions))
    names = [(split, *at) for split in SPLITS for at in np.ndindex(len(split.shards), 2)]
    plain = {s.name: plain_tracking(pairing.truth, guessed, thresholds, s, CUTOFFS) for s in SPLITS}
    for result, (split, shard, level) in zip(fast, names, strict=True):
        for count, slow in plain[split.name].items():
            ours = getattr(result.counts, count)
            np.testing.assert_allclose(ours, slow[level, shard], atol=1e-9, err_msg=f"{result.name} {count}")
