"""Two populations are told apart where they meet, also when one is small."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.background.threshold import minimum_error_threshold


@pytest.mark.parametrize("small", [0.5, 0.1, 0.03])
def test_the_threshold_lies_between_two_populations(small: float) -> None:
    rng = np.random.default_rng(0)
    values = np.concatenate(
        [rng.normal(0.1, 0.05, int(20000 * small)), rng.normal(0.7, 0.1, int(20000 * (1 - small)))]
    )
    found = minimum_error_threshold(*np.histogram(values, 200))
    wrong = (values[: int(20000 * small)] > found).sum() + (values[int(20000 * small) :] <= found).sum()
    assert wrong < 60  # of 20 000


def plain_threshold(counts: np.ndarray, edges: np.ndarray) -> float:
    """Kittler and Illingworth's criterion J = 1 + 2 sum P log(s / P), written out for each cut."""
    center = (edges[1:] + edges[:-1]) / 2
    criterion = {}
    for cut in range(1, len(counts)):
        cost = 1.0
        for part, values in ((counts[:cut], center[:cut]), (counts[cut:], center[cut:])):
            prior = part.sum() / counts.sum()
            if prior < 1e-3:
                break
            mean = np.average(values, weights=part)
            sigma = np.sqrt(np.average((values - mean) ** 2, weights=part) + (edges[1] - edges[0]) ** 2 / 12)
            cost += 2 * prior * np.log(sigma / prior)
        else:
            criterion[cut] = cost
    return float(edges[min(criterion, key=criterion.__getitem__)]) if criterion else float(center.mean())


@pytest.mark.parametrize("seed", range(6))
def test_the_threshold_minimizes_the_criterion_of_the_paper(seed: int) -> None:
    rng = np.random.default_rng(seed)
    edges = np.linspace(-1, 1, 31)
    counts = rng.integers(1, 40, 30)  # an empty bin would make two cuts equal
    assert minimum_error_threshold(counts, edges) == pytest.approx(plain_threshold(counts, edges))


def test_one_population_in_one_bin_has_no_threshold_but_the_middle() -> None:
    counts = np.zeros(10)
    counts[3] = 5
    assert minimum_error_threshold(counts, np.linspace(0, 1, 11)) == pytest.approx(0.5)


def test_two_bins_are_separated_between_them() -> None:
    counts = np.zeros(10)
    counts[[2, 7]] = 100, 100
    assert 0.3 - 1e-9 <= minimum_error_threshold(counts, np.linspace(0, 1, 11)) <= 0.7 + 1e-9
