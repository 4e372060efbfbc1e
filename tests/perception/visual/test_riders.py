"""A person and what the person rides become one box; who stands beside a bicycle does not."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.visual.riders import merge_riders
from upvl_cli.types import Boxes2d, empty

PERSON = [100.0, 50, 130, 130]


def boxes(*rows: tuple[str, list[float], float]) -> Boxes2d:
    names, edges, scores = zip(*rows, strict=True)
    return Boxes2d(np.array(edges), np.array(scores), np.array(names))


@pytest.mark.parametrize(
    ("vehicle", "edges", "name"),
    [
        ("bicycle", [90.0, 95, 140, 150], "cyclist"),
        ("motorcycle", [90, 95, 140, 150], "motorcyclist"),
        ("bicycle", [105, 95, 125, 150], "cyclist"),  # seen from behind
        ("bicycle", [90, 136, 140, 170], "cyclist"),  # the legs are hidden
        ("bicycle", [90, 150, 140, 190], None),  # below, too far away
        ("bicycle", [90, 60, 140, 150], None),  # as high as the person: one who stands behind it
        ("bicycle", [120, 95, 170, 150], None),  # beside
        ("bicycle", [90, 70, 140, 110], None),  # the person's feet are below its wheels
        ("chair", [90, 95, 140, 150], None),
    ],
)
def test_a_person_rides_what_is_below(vehicle: str, edges: list[float], name: str | None) -> None:
    found = merge_riders(boxes((vehicle, edges, 0.5), ("person", PERSON, 0.9)))
    if name is None:
        assert found.name.tolist() == [vehicle, "person"]
        np.testing.assert_array_equal(found.xyxy_px, [edges, PERSON])
    else:
        around = [min(PERSON[0], edges[0]), PERSON[1], max(PERSON[2], edges[2]), edges[3]]
        assert (found.name.tolist(), found.score.tolist()) == ([name], [0.9])
        np.testing.assert_array_equal(found.xyxy_px, [around])


def test_each_bicycle_has_one_rider_the_surer_one() -> None:
    second = [104.0, 52, 134, 132]
    found = merge_riders(
        boxes(("person", PERSON, 0.4), ("person", second, 0.9), ("bicycle", [95, 95, 140, 150], 0.5))
    )
    assert found.name.tolist() == ["person", "cyclist"]
    np.testing.assert_array_equal(found.xyxy_px[0], PERSON)


def test_no_boxes() -> None:
    assert len(merge_riders(empty(Boxes2d))) == 0
