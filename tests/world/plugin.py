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


def labels(root: Path, dataset: Any) -> StreetLabels:
    """Return the exact boxes of the streets."""
    return StreetLabels()


def true_flow(root: Path, dataset: Any) -> StreetFlow:
    """Return the true flow of the streets."""
    return StreetFlow()
