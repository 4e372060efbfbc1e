"""What no camera sees has the state of its place, or of what has its shape."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.perception.background.completion import (
    BackgroundCompletion,
    CompletionEvidence,
    SweepBackground,
)
from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.background.shape_classifier import ShapeFeatures, compute_shape_features
from upvl_cli.perception.windows import fits_by_window
from upvl_cli.stages.mask import MaskConfig

CONFIG = load(MaskConfig, Path(__file__).parents[3] / "stages" / "mask.toml")


def shapes(xyz: np.ndarray, height: np.ndarray) -> ShapeFeatures:
    return compute_shape_features(xyz, height, CONFIG.shape_classifier)


def completion(sweeps: list[SweepBackground]) -> BackgroundCompletion:
    evidence = CompletionEvidence(CONFIG.place_memory, CONFIG.shape_classifier)
    for sweep in sweeps:
        evidence.add(sweep)
    return evidence.fit()


def sheet(x_m: float, y_m: float, length_m: float, top_m: float) -> np.ndarray:
    """Points of an upright surface that runs along x and stands on the ground."""
    along, up = np.meshgrid(np.arange(0, length_m, 0.15), np.arange(0.3, top_m, 0.15))
    return np.stack([x_m + along.ravel(), np.full(along.size, y_m), up.ravel()], axis=1)


def street() -> tuple[SweepBackground, np.ndarray]:
    """Ten house fronts and ten sides of cars, and which points are of houses; the last of each was never seen."""
    parts, houses, unseen = [], [], []
    for number in range(10):
        for points, is_house in ((sheet(12 * number, 9, 8, 6.0), 1), (sheet(12 * number, 3, 4, 1.5), 0)):
            parts.append(points)
            houses.append(np.full(len(points), is_house))
            unseen.append(np.full(len(points), number == 9))
    xyz, house = np.concatenate(parts), np.concatenate(houses)
    state = np.where(np.concatenate(unseen), UNKNOWN, house)
    return SweepBackground(state, np.zeros(len(xyz), bool), xyz, shapes(xyz, xyz[:, 2])), house


def test_what_was_never_seen_has_the_state_of_its_shape() -> None:
    seen, house = street()
    asked = seen.background == UNKNOWN
    told = completion([seen]).complete(seen)
    assert (told[~asked] == house[~asked]).all()
    assert (told[asked] == house[asked]).mean() > 0.95


def test_what_moves_unseen_stays_unknown() -> None:
    seen, _ = street()
    fast = np.ones(len(seen.background), bool)
    assert (completion([seen]).complete(replace(seen, is_moving=fast)) == seen.background).all()


def test_without_looks_only_places_count() -> None:
    seen, house = street()
    asked = seen.background == UNKNOWN
    plain = replace(seen, shape=None)
    assert (completion([plain]).complete(plain)[asked] == UNKNOWN).all()
    later = replace(plain, background=house)  # it was seen after all, at another time
    assert (completion([plain, later]).complete(plain) == house).all()


def test_nothing_is_learned_where_cameras_saw_one_state_alone() -> None:
    seen, _ = street()
    background = np.where(seen.background == 0, UNKNOWN, seen.background)
    asked = background == UNKNOWN
    alone = replace(seen, background=background, xyz_world_m=seen.xyz_world_m)
    assert (completion([alone]).complete(alone)[asked] == UNKNOWN).all()
    assert (completion([]).complete(alone) == background).all()


def test_a_sweep_without_points() -> None:
    nothing = SweepBackground(
        np.zeros(0, np.int8), np.zeros(0, bool), np.zeros((0, 3)), shapes(np.zeros((0, 3)), np.zeros(0))
    )
    assert completion([nothing]).complete(nothing).shape == (0,)


def test_a_place_seen_at_another_time_comes_before_the_shape() -> None:
    """A house front that a camera took for an object stays one at its place, whatever its shape says."""
    sweep, house = street()
    asked = (sweep.background == UNKNOWN) & (house == 1)
    later = replace(sweep, background=np.where(asked, 0, UNKNOWN))
    found = completion([sweep, later]).complete(sweep)
    assert (found[asked] == 0).all()
    by_shape = completion([sweep]).complete(sweep)
    assert (by_shape[asked] == 1).mean() > 0.95


def test_what_moved_when_it_was_seen_is_not_remembered() -> None:
    sweep, _ = street()
    plain = replace(sweep, shape=None)
    asked = plain.background == UNKNOWN
    passing = replace(plain, background=np.zeros(len(asked), int), is_moving=np.ones(len(asked), bool))
    assert (completion([plain, passing]).complete(plain)[asked] == UNKNOWN).all()


def test_a_seen_point_keeps_its_own_state() -> None:
    sweep, house = street()
    others = [replace(sweep, background=1 - house) for _ in range(3)]
    known = sweep.background != UNKNOWN
    assert (completion([sweep, *others]).complete(sweep)[known] == house[known]).all()


def spots(step: int, background: int) -> SweepBackground:
    """A point of its own for each sweep, and that of all others, unseen; each 10 m from the next."""
    xyz = np.column_stack([10.0 * np.arange(60) + 0.1, np.zeros(60), np.ones(60)])
    state = np.full(60, UNKNOWN)
    state[step] = background
    return SweepBackground(state, np.zeros(60, bool), xyz, None)


def test_a_long_drive_is_completed_by_the_seconds_around_each_sweep() -> None:
    """60 s by windows of 20 s: each sweep knows the places of 5 s before and after at least, and of 20 s at most."""
    time_s, known, taken = np.arange(60.0), {}, 0

    def sweeps() -> Iterator[SweepBackground]:
        nonlocal taken
        for step in range(60):
            taken += 1
            yield spots(step, step % 2)

    for part, found in fits_by_window(
        time_s, sweeps(), 20.0, lambda: CompletionEvidence(CONFIG.place_memory, CONFIG.shape_classifier)
    ):
        assert taken <= part[0] + 21, "no sweep is taken before it is needed"
        for step in part:
            state = found.complete(spots(step, step % 2))
            places = np.flatnonzero(state != UNKNOWN)
            assert (state[places] == places % 2).all()
            known[step] = places
    assert list(known) == list(range(60))
    for step, places in known.items():
        assert places.tolist() == list(range(places[0], places[-1] + 1))
        assert places[0] <= max(0, step - 5)
        assert places[-1] >= min(59, step + 5)
        assert len(places) <= 21


def test_a_short_drive_is_one_window() -> None:
    seen = [spots(step, 1) for step in range(21)]
    ((part, found),) = fits_by_window(
        np.arange(21.0), seen, 20.0, lambda: CompletionEvidence(CONFIG.place_memory, CONFIG.shape_classifier)
    )
    assert part == range(21)
    assert (found.complete(seen[0]) != UNKNOWN).sum() == 21
    assert not list(
        fits_by_window(
            np.zeros(0), [], 20.0, lambda: CompletionEvidence(CONFIG.place_memory, CONFIG.shape_classifier)
        )
    )
