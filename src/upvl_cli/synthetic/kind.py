"""A kind of thing: what people call it, and how to build one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from upvl_cli.synthetic.model import ObjectModel

VEHICLE, PEDESTRIAN, SIGN, CYCLIST, OTHER = 1, 2, 3, 4, 0  # Waymo's numbers, and one for all else


@dataclass(frozen=True)
class Kind:
    """A kind of object.

    Attributes:
        name: Its usual name, in lower case: "fire truck".
        words: Other words and short phrases that people use for it.
        type: Waymo's number of its class.
        build: Makes one, with colours and sizes by chance.
        speed_mps: Usual speeds, from and to; (0, 0) where it never moves by itself.
        place: Where it is met: "lane", "parked", "pavement", "crossing" or "roadside"; one or more.
        share: How often it is met among those of the same place, compared with 1.
    """

    name: str
    words: tuple[str, ...]
    type: int
    build: Callable[[np.random.Generator], ObjectModel]
    speed_mps: tuple[float, float]
    place: tuple[str, ...]
    share: float = 1.0
