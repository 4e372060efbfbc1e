"""The part of the ground that counts."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.errors import BadSetting
from upvl_cli.evaluation.region import Region


@pytest.mark.parametrize("text", ["100x40", "100X40", "100.0x4e1"])
def test_a_region_is_length_by_width(text: str) -> None:
    assert Region.parse(text) == Region(100.0, 40.0)


@pytest.mark.parametrize(
    "text", ["", "100", "100x", "x40", "0x40", "-1x40", "nanx40", "infx40", "1x2x3", "a x b"]
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(BadSetting, match="such as 100x40"):
        Region.parse(text)


def test_the_edge_belongs_to_it_and_height_does_not_matter() -> None:
    places = np.array([[50, 20, 99], [-50, -20, 0], [50.1, 0, 0], [0, 20.1, 0], [0, 0, 0]])
    assert Region(100.0, 40.0).contains(places).tolist() == [True, True, False, False, True]


def test_nothing_lies_nowhere() -> None:
    assert Region(1.0, 1.0).contains(np.zeros((0, 3))).tolist() == []
