"""Persons close together are told apart, and nothing else falls apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from proposal_scene import CROWD, block

from upvl_cli.perception.proposals.config import CrowdConfig
from upvl_cli.perception.proposals.crowd import split_crowds

PERSON = (0.4, 0.5, 1.7)


def split_crowd(points: np.ndarray, config: CrowdConfig) -> np.ndarray:
    """The persons of one cluster."""
    return split_crowds(points, np.zeros(len(points), np.int64), config)


def split(*objects: np.ndarray, **values: float) -> list[list[int]]:
    """The numbers of the persons of each object, each once."""
    numbers = split_crowd(np.concatenate(objects), replace(CROWD, **values))
    ends = np.cumsum([len(points) for points in objects])[:-1]
    return [np.unique(part).tolist() for part in np.split(numbers, ends)]


def test_persons_with_a_gap_are_several_from_the_first_on() -> None:
    # Faces at 0.4 m, 0.3 m apart.
    assert split(block(10, 0, PERSON), block(10.7, 0, PERSON), block(11.4, 0, PERSON)) == [[0], [1], [2]]


def test_persons_without_a_gap_are_one() -> None:
    assert split(block(10, 0, PERSON), block(10.5, 0, PERSON)) == [[0], [0]]


def test_the_gap_is_a_setting() -> None:
    assert split(block(10, 0, PERSON), block(10.7, 0, PERSON), gap_m=0.4) == [[0], [0]]


def test_persons_whom_few_beams_meet_are_persons_too() -> None:
    ring = np.array([[0.0, 0, 0], [0.15, 0.1, 0], [0.3, 0, 0]])
    person = np.concatenate([ring + [10, 0, z] for z in (0.3, 0.8, 1.3)])  # far apart up and down
    assert split(person, person + [0.8, 0, 0]) == [[0], [1]]


def test_one_person_is_one_and_no_points_are_none() -> None:
    assert split(block(10, 0, PERSON)) == [[0]]
    assert split_crowd(np.zeros((0, 3)), CROWD).shape == (0,)


@pytest.mark.parametrize(
    ("size", "is_person"),
    [
        ((0.4, 0.5, 1.7), True),
        ((0.4, 1.1, 1.7), True),  # a stride
        ((0.4, 1.4, 1.7), False),  # wider than a stride
        ((0.1, 0.1, 1.7), False),  # a stripe
        ((0.1, 0.3, 1.7), True),  # flat, but one side is broad enough
        ((0.4, 0.5, 0.7), False),  # too low
        ((0.4, 0.5, 0.9), True),  # a child
        ((0.4, 1.0, 0.9), False),  # wider than tall
        ((0.4, 0.5, 2.4), False),  # too tall
        ((0.4, 0.5, 2.1), True),
    ],
)
def test_what_has_the_size_of_a_person(size: tuple[float, float, float], is_person: bool) -> None:
    pair = block(10, 0, size), block(12, 0, size)
    assert split(*pair) == ([[0], [1]] if is_person else [[0], [0]])


def test_a_person_beside_something_else_is_split_only_where_that_is_small() -> None:
    persons = block(10, 0, PERSON), block(11, 0, PERSON)
    total = sum(map(len, persons))
    low = block(12, 0, (0.4, 0.5, 0.3))  # no person
    few = low[:: len(low) // (total // 20)]  # a twentieth: below the tenth that may be left over
    assert split(*persons, few) == [[0], [1], [1]]  # what is left over joins the nearest person
    many = np.concatenate([low] * 3)
    assert len(many) > total / 9
    assert split(*persons, many) == [[0], [0], [0]]


def test_stray_points_join_the_nearest_person() -> None:
    persons = block(10, 0, PERSON), block(11, 0, PERSON)
    stray = np.array([[9.5, 0.0, 1.0]]), np.array([[11.5, 0.0, 1.0]])
    assert split(*persons, *stray) == [[0], [1], [0], [1]]


def test_a_patch_that_is_no_person_takes_no_number() -> None:
    low = block(9, 0, (0.3, 0.3, 0.2), step_m=0.15)
    assert split(low, block(10, 0, PERSON), block(11, 0, PERSON)) == [[0], [0], [1]]


def test_clusters_are_split_as_each_alone() -> None:
    rng = np.random.default_rng(0)
    clusters = [
        np.concatenate([block(10, 0, PERSON, step_m=0.15) + [0.8 * k, 0, 0] for k in range(persons)])
        + rng.normal(0, 0.02, 3)
        for persons in (1, 3, 2, 4)
    ]
    clusters.insert(2, block(12, 0, (4.0, 1.8, 1.5), step_m=0.3))
    number = np.repeat(np.arange(len(clusters)), [len(points) for points in clusters])
    found = split_crowds(np.concatenate(clusters), number, CROWD)
    assert [int(found[number == k].max()) + 1 for k in range(len(clusters))] == [1, 3, 1, 2, 4]
    np.testing.assert_array_equal(found, np.concatenate([split_crowd(points, CROWD) for points in clusters]))
