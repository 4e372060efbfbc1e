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
