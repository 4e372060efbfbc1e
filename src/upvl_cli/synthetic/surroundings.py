"""Everything in the city that never moves."""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic.buildings import buildings
from upvl_cli.synthetic.ground import ground
from upvl_cli.synthetic.piece import Piece
from upvl_cli.synthetic.road import Road
from upvl_cli.synthetic.roadside import roadside


def surroundings(road: Road, rng: np.random.Generator) -> list[Piece]:
    """Return the ground and all that stands on it."""
    return [*ground(road), *buildings(road, rng), *roadside(road, rng)]
