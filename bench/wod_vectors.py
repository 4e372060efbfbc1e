"""Compare our scores with those of the official Waymo tools on vectors: `wod_vectors.py FILE...`.

A file holds labels, predictions and the values that the official code gave for them (shared/wod/vectors).
Prints how many results were compared and the largest difference. Counts must be equal; a float may be off
by 1e-6, as a share of its value where that is above 1, for the files hold nine digits. Exits 0 if all agree,
1 if not, 2 if a file cannot be read.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.metrics.waymo.breakdown import BREAKDOWNS
from upvl_cli.metrics.waymo.detection import DetectionResult, detection
from upvl_cli.metrics.waymo.inputs import Predictions, Truth, map_types, resolve_level
from upvl_cli.metrics.waymo.official import IOU_THRESHOLDS, SCORE_CUTOFFS
from upvl_cli.metrics.waymo.tracking import TrackingResult, tracking

TOLERANCE = 1e-6
MATCHERS = {"TYPE_HUNGARIAN": "hungarian", "TYPE_SCORE_FIRST": "score_first"}
LABEL_KEYS = {
    *("context", "frame", "type", "box", "num_points"),
    *("detection_difficulty", "tracking_difficulty", "speed", "id"),
}
PREDICTION_KEYS = {"context", "frame", "type", "box", "score", "id", "overlap_nlz", "speed"}
DETECTION = {
    **{"AP": "ap", "mAP": "ap", "APH": "aph", "mAPH": "aph"},
    **{"tp": "tp", "fp": "fp", "fn": "fn", "sum_ha": "sum_ha"},
}
TRACKING = {
    **{"MOTA": "mota", "MOTP": "motp", "miss": "miss", "mismatch": "mismatch", "fp": "false_positive"},
    **{"Miss": "miss", "Mismatch": "mismatch", "FP": "false_positive"},
    **{"num_objects_gt": "labels", "score_cutoff": "score_cutoff"},
    **{"n_miss": "counts.miss", "n_fp": "counts.false_positive", "n_mismatch": "counts.mismatch"},
    **{"n_match": "counts.match", "n_gt": "counts.truth", "matching_cost": "counts.cost"},
}
COUNTS = {"tp", "fp", "fn", "labels"} | {f"counts.{n}" for n in ("miss", "false_positive", "mismatch")}
COUNTS |= {"counts.match", "counts.truth"}


@dataclass(frozen=True)
class Task:
    """One run of an official tool: what it was given, and what it gave."""

    where: str
    tracked: bool
    merged: bool
    rule: dict[str, Any]
    expected: Mapping[str, Mapping[str, Any]]


@dataclass
class Total:
    """What was compared so far."""

    results: int = 0
    numbers: int = 0
    worst: float = 0.0
    unequal: int = 0


def need(mapping: Any, keys: set[str], where: str) -> Mapping[str, Any]:
    """Return the mapping if it has these keys."""
    missing = sorted(keys - set(mapping)) if isinstance(mapping, dict) else sorted(keys)
    if missing or not isinstance(mapping, dict):
        raise BadInput(f"{where} has no {', '.join(missing) or 'keys'}: not the layout of shared/wod/vectors")
    return mapping


def tasks(vector: Mapping[str, Any]) -> Iterator[Task]:
    """Yield the runs that a file holds."""
    for section, runs in need(vector["expected"], set(), "expected").items():
        if section == "official_binary_default":
            for tool, results in need(runs, set(), section).items():
                yield Task(f"{section}.{tool}", is_tracking(tool), False, default_rule(), results)
            continue
        tracked = is_tracking(section)
        for name, run in need(runs, set(), section).items():
            where = f"{section}.{name}"
            run = need(run, {"iou_thresholds", "matcher", "breakdowns", "result"}, where)
            merged = section.endswith("vru_merged")
            yield Task(where, tracked, merged, rule_of(run, where), run["result"])


def is_tracking(name: str) -> bool:
    """Return which tool a section is about."""
    tool = name.split("_")[0]
    if tool not in ("detection", "tracking"):
        raise BadInput(f"section {name} is unknown, expected detection… or tracking…")
    return tool == "tracking"


def rule_of(run: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the settings of a run as our functions take them."""
    unknown = [b for b in run["breakdowns"] if b not in BREAKDOWNS]
    if unknown or run["matcher"] not in MATCHERS:
        raise BadInput(
            f"{where}: breakdowns {run['breakdowns']} or matcher {run['matcher']} are not known here"
        )
    return {
        "iou_thresholds": run["iou_thresholds"],
        "breakdowns": [BREAKDOWNS[name] for name in run["breakdowns"]],
        "score_cutoffs": np.asarray(run.get("score_cutoffs", SCORE_CUTOFFS), dtype=np.float32),
        "matcher": MATCHERS[run["matcher"]],
    }


def default_rule() -> dict[str, Any]:
    """Return the settings of the official command line tools."""
    names = ["OBJECT_TYPE", "RANGE"]
    run = {"iou_thresholds": IOU_THRESHOLDS, "breakdowns": names, "matcher": "TYPE_HUNGARIAN"}
    return rule_of(run, "default")


def boxes(vector: Mapping[str, Any], task: Task) -> tuple[Truth, Predictions]:
    """Return labels and predictions as the tool of the task prepares them."""
    g, p = need(vector["gt"], LABEL_KEYS, "gt"), need(vector["pd"], PREDICTION_KEYS, "pd")
    raw = np.asarray(g["tracking_difficulty" if task.tracked else "detection_difficulty"], dtype=np.int64)
    points = np.asarray(g["num_points"], dtype=np.int64)
    level = raw if task.tracked else resolve_level(raw, points)
    truth = Truth.from_rows(
        g["box"],
        sequence=g["context"],
        frame=g["frame"],
        type=g["type"],
        level=level,
        velocity_mps=velocity(g["speed"]),
        object_id=g["id"],
    )
    truth = truth if task.tracked else truth[points > 0]
    predictions = Predictions.from_rows(
        p["box"],
        sequence=p["context"],
        frame=p["frame"],
        type=p["type"],
        score=p["score"],
        velocity_mps=velocity(p["speed"]),
        object_id=p["id"],
        unlabelled=p["overlap_nlz"],
    )
    types = {4: 2} if task.merged else {}
    return map_types(truth, types), map_types(predictions, types)


def velocity(speed: list[Any]) -> list[list[float]]:
    """Return speeds with NaN where there is none."""
    return [[np.nan, np.nan] if s is None else s for s in speed]


def compare(task: Task, vector: Mapping[str, Any], total: Total) -> None:
    """Add the differences of one run to the total, and print what disagrees."""
    truth, predictions = boxes(vector, task)
    score = tracking if task.tracked else detection
    ours = {result.name: result for result in score(truth, predictions, **task.rule)}
    names = TRACKING if task.tracked else DETECTION
    for name, fields in task.expected.items():
        unknown = [field for field in fields if field not in names]
        if unknown or name not in ours:
            raise BadInput(f"{task.where}: result {name} or its fields {unknown} are not known here")
        total.results += 1
        for field, value in fields.items():
            check(f"{task.where} {name} {field}", ours[name], names[field], value, total)


def check(where: str, ours: DetectionResult | TrackingResult, name: str, theirs: Any, total: Total) -> None:
    """Compare one number, or one number a cut-off."""
    mine = attrgetter(name)(ours)
    a, b = (np.asarray(np.nan if v is None else v, dtype=np.float64) for v in (mine, theirs))
    if a.shape != b.shape:
        raise BadInput(f"{where} holds {b.size} numbers, expected {a.size}: other score cut-offs?")
    apart = np.where(
        np.isnan(a) | np.isnan(b), np.where(np.isnan(a) == np.isnan(b), 0, np.inf), np.abs(a - b)
    )
    if name not in COUNTS:
        apart = apart / np.maximum(1, np.abs(np.nan_to_num(b)))
    total.numbers += a.size
    total.worst = max(total.worst, float(apart.max(initial=0)))
    if (apart > (0 if name in COUNTS else TOLERANCE)).any():
        total.unequal += 1
        at = int(apart.argmax())
        print(f"  differs: {where}: ours {a.flat[at]:.9g}, official {b.flat[at]:.9g}")


def read(path: str) -> Mapping[str, Any]:
    """Return the content of a file."""
    try:
        vector = json.loads(Path(path).read_text())
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise BadInput(f"is not JSON: {error}") from error
    return need(vector, {"gt", "pd", "expected"}, "the file")


def main(paths: list[str]) -> int:
    """Compare all files and return the exit code."""
    if not paths:
        print("usage: wod_vectors.py FILE...", file=sys.stderr)
        return 2
    total = Total()
    for path in paths:
        before = total.results
        try:
            vector = read(path)
            for task in tasks(vector):
                compare(task, vector, total)
        except (BadInput, TypeError, ValueError, AttributeError) as error:
            print(f"{path}: {error}", file=sys.stderr)
            return 2
        print(f"{Path(path).name}: {total.results - before} results")
    print(
        f"compared {total.results} results ({total.numbers} numbers): largest difference {total.worst:.2g}, "
        f"{total.unequal} beyond {TOLERANCE:g}"
    )
    return 1 if total.unequal else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
