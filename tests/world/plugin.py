"""Adds the street to upvl, as a package of somebody else would (entry points in `upvl_test_world-0.dist-info`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from upvl_cli.datasets.registry import DatasetFamily
from world.labels import StreetLabels
from world.street import Streets
from world.truth import StreetFlow


def _open(root: Path, config: None) -> Streets:
    return Streets()


FAMILY = DatasetFamily(_open)


def _open_many(root: Path, config: None) -> Streets:
    """Return as many streets as the name of the folder has, each of so many frames: 60x3."""
    return Streets(**_named(root))


def _named(root: Path) -> dict[str, Any]:
    number, _, frames = root.name.partition("x")
    return {"frames": int(frames), "seeds": tuple(range(int(number)))}


MANY = DatasetFamily(_open_many)


def labels(root: Path, dataset: Any) -> StreetLabels:
    """Return the exact boxes of the streets."""
    return StreetLabels()


def many_labels(root: Path, dataset: Any) -> StreetLabels:
    """Return the exact boxes of as many streets as the name of the folder has."""
    return StreetLabels(**_named(root))


def true_flow(root: Path, dataset: Any) -> StreetFlow:
    """Return the true flow of the streets."""
    return StreetFlow()
