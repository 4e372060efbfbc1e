"""What is wrong with a drive before it is labelled: its times, its pictures and its calibration, without any label."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.algorithms.calibration import Offset, View, calibration_offset, is_off, is_told
from upvl_cli.geometry.se3 import apply, between, inverse
from upvl_cli.parallel import in_order
from upvl_cli.stages import BY_NAME
from upvl_cli.tables import Table
from upvl_cli.types import Array, Camera, Frame, Image

if TYPE_CHECKING:
    from upvl_cli.datasets.base import Drive
    from upvl_cli.workspace import Workspace
