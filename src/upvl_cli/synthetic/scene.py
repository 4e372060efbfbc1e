"""A stretch of city with everything that stands and moves in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from upvl_cli.synthetic.kind import Kind
from upvl_cli.synthetic.model import ObjectModel
from upvl_cli.synthetic.motion import Motion
from upvl_cli.synthetic.piece import STUFF, Piece
from upvl_cli.synthetic.surface import Finish
from upvl_cli.types import Ints

STUFF_NAMES = tuple(STUFF)


@dataclass(frozen=True)
class Thing:
    """One object.

    Attributes:
        kind: What it is.
        model: What it is made of.
        motion: Where it goes.
    """

    kind: Kind
    model: ObjectModel
    motion: Motion


@dataclass(frozen=True)
class CityScene:
    """What there is.

    Attributes:
        things: The objects.
        pieces: What never moves.
        ego: Way of the car that carries the sensors.
    """

    things: tuple[Thing, ...]
    pieces: Sequence[Piece]
    ego: Motion

    @cached_property
    def surfaces(self) -> tuple[Finish, ...]:
        """All materials, each once."""
        meshes = [piece.mesh for piece in self.pieces]
        meshes += [part.mesh for thing in self.things for part in thing.model.parts]
        return tuple(dict.fromkeys(surface for mesh in meshes for surface in mesh.surfaces))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What pixels and points can belong to: STUFF, then the kinds of the things, each once."""
        return tuple(dict.fromkeys((*STUFF_NAMES, *(thing.kind.name for thing in self.things))))

    @cached_property
    def name_of_thing(self) -> Ints:
        """(t,) place in `names` of each thing."""
        number = {name: place for place, name in enumerate(self.names)}
        return np.array([number[thing.kind.name] for thing in self.things], dtype=np.int64)
