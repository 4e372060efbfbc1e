"""The human (or exact) labels of each dataset. Only evaluation may import this: no stage can reach a label."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from upvl_cli.datasets.base import LabelSource
from upvl_cli.types import Ints

if TYPE_CHECKING:
    from upvl_cli.datasets.synthetic_truth import FlowTruth


class LabelledFrames(LabelSource, Protocol):
    """Labels that also say which frames were labelled: of the others nothing is known."""

    def frames(self, segment: str) -> Ints:
        """(f,) index of each labelled frame; raises `BadInput` where the drive has no labels."""


class FlowSource(Protocol):
    """True motion of LiDAR points."""

    def flow(self, segment: str, frame: int) -> FlowTruth:
        """The motion of each point of a sweep, in the order of its points."""


def _kitti(root: Path) -> LabelledFrames:
    from upvl_cli.datasets.kitti_labels import KittiLabels

    return KittiLabels(root)


def _synthetic(root: Path) -> LabelledFrames:
    from upvl_cli.datasets.synthetic_truth import SyntheticTruth

    return SyntheticTruth()


def _synthetic_flow(root: Path) -> FlowSource:
    from upvl_cli.datasets.synthetic_truth import SyntheticTruth

    return SyntheticTruth()


LABELS: dict[str, Callable[[Path], LabelledFrames]] = {"kitti": _kitti, "synthetic": _synthetic}
TRUE_FLOW: dict[str, Callable[[Path], FlowSource]] = {"synthetic": _synthetic_flow}
