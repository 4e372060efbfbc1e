"""Background state of the points that no camera sees at the moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.background.config import PlaceMemoryConfig, ShapeClassifierConfig
from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.background.place_memory import PlaceMemory, PlaceSums
from upvl_cli.perception.background.shape_classifier import ShapeClassifier, ShapeFeatures, training_samples
from upvl_cli.types import Array, Bools, Floats, Ints


@dataclass(frozen=True)
class SweepBackground:
    """What the cameras tell of the points of one sweep that are above the ground.

    Attributes:
        background: (n,) 1 where a camera sees background, 0 where something else, `UNKNOWN` where none looks.
        is_moving: (n,) whether the point moves.
        xyz_world_m: (n, 3) points in world axes.
        shape: Shape of their surroundings; None where only places count.
    """

    background: Ints
    is_moving: Bools
    xyz_world_m: Floats
    shape: ShapeFeatures | None


class CompletionEvidence:
    """What the cameras saw of places and shapes, gathered sweep by sweep."""

    def __init__(self, place_memory: PlaceMemoryConfig, shape_classifier: ShapeClassifierConfig) -> None:
        """Start without any.

        Args:
            place_memory: Settings of the memory of places.
            shape_classifier: Settings of the classifier of shapes.
        """
        self._places = PlaceSums(place_memory)
        self._samples: list[tuple[Floats, Ints]] = []
        self._shape_config = shape_classifier

    def add(self, sweep: SweepBackground) -> None:
        """Add the seen static points of a sweep, and the training samples of its shapes."""
        if sweep.shape is not None:
            self._samples.append(training_samples(sweep.shape, sweep.background, self._shape_config))
        static = (sweep.background != UNKNOWN) & ~sweep.is_moving
        self._places.add(sweep.xyz_world_m[static], sweep.background[static] == 1)

    def fit(self) -> BackgroundCompletion:
        """Return what completes the sweeps, fitted to all that were added."""
        classifier = ShapeClassifier(self._samples, self._shape_config)
        return BackgroundCompletion(self._places.memory(), classifier)


@dataclass(frozen=True)
class BackgroundCompletion:
    """Completes the state of unseen points: from the same place at another time, else from what has its shape.

    Attributes:
        memory: States of places.
        classifier: States of shapes.
    """

    memory: PlaceMemory
    classifier: ShapeClassifier

    def complete(self, sweep: SweepBackground) -> Array:
        """Return (n,) int8 state of each point of a sweep; an unseen point that moves stays `UNKNOWN`."""
        state = np.array(sweep.background, dtype=np.int8)
        unseen = np.flatnonzero((state == UNKNOWN) & ~sweep.is_moving)
        state[unseen] = self.memory.lookup(sweep.xyz_world_m[unseen])
        if sweep.shape is not None:
            unseen = unseen[state[unseen] == UNKNOWN]
            state[unseen] = self.classifier.classify(sweep.shape)[unseen]
        return state
