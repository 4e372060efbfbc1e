"""Everything in the city that never moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.synthetic.buildings import buildings
from upvl_cli.synthetic.clutter import cleared, clutter_pieces
from upvl_cli.synthetic.ground import ground
from upvl_cli.synthetic.land import Stretch
from upvl_cli.synthetic.piece import Piece
from upvl_cli.synthetic.road import Road
from upvl_cli.synthetic.roadside import roadside


def surroundings(road: Road, rng: np.random.Generator) -> list[Piece]:
    """Return the ground and all that stands on it."""
    return [*ground(road), *buildings(road, rng), *roadside(road, rng)]


def cluttered(
    pieces: Sequence[Piece], road: Road, land: Sequence[Stretch], rng: np.random.Generator, clutter: float
) -> list[Piece]:
    """Return the surroundings with open land and with all that `clutter` adds; the same at 0.

    Args:
        pieces: What never moves.
        road: The street.
        land: The stretches of open land.
        rng: Source of all chance.
        clutter: How much is added.
    """
    return [*cleared(pieces, road, land), *clutter_pieces(road, land, rng, clutter)] if clutter else [*pieces]
