"""Frames of many drives to train on; only some of them are in memory at once."""

from __future__ import annotations

import resource
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from upvl_cli.detector.config import TrainConfig
from upvl_cli.detector.data.augment import augment
from upvl_cli.detector.data.batch import Sample
from upvl_cli.detector.data.numbers import FrameNumbers
from upvl_cli.detector.data.sampler import FrameOrder, generator_at
from upvl_cli.detector.data.scene import TrainingScene
from upvl_cli.detector.data.sweeps import TwoSweeps
from upvl_cli.detector.grid import Grid
from upvl_cli.types import Boxes, Floats, Ints, concat

_OPEN_DRIVES = 128  # as many as a window of the order has, mostly; each holds a few files open
_FILES_OF_DRIVE = 4
_SCENES = 64  # in memory, of some 10 MB each: a small set is read from disk once, a large one streams


@dataclass(frozen=True)
class Source:
    """Where the frames of a drive are from.

    Attributes:
        sweeps: Its two-frame input.
        features: Returns the points of a frame that a camera sees, (c,), and their features, (c, 64) int8.
        labels: Returns the auto labels of a frame in ego axes, and their (m, 3) velocities.
    """

    sweeps: TwoSweeps
    features: Callable[[int], tuple[Ints, Ints]]
    labels: Callable[[int], tuple[Boxes, Floats]]


class DriveFrames:
    """The frames of drives, by number: first those to train on, then those held out (`train.Frames`)."""

    def __init__(
        self,
        drives: Sequence[str],
        lengths: Ints,
        source: Callable[[str], Source],
        *,
        grid: Grid,
        values: Callable[[Ints], Floats],
        config: TrainConfig,
        corrected: Collection[str] = (),
    ) -> None:
        """Assign numbers to the frames; nothing is opened before it is asked for.

        Args:
            drives: Names of the drives.
            lengths: (D,) how many frames each of them has.
            source: Opens a drive.
            grid: What the network sees.
            values: Returns the kept values of features.
            config: Share that is held out, order, random changes, sampling and seed.
            corrected: Drives with hand corrections; their frames are drawn several times as often.
        """
        self._drives = drives
        self._source = lru_cache(maxsize=_most_open_drives())(source)
        self._scene = lru_cache(maxsize=_SCENES)(self._read_scene)
        self._grid, self._values, self._config = grid, values, config
        repeats = np.ones(len(drives), np.int32)
        if corrected:
            names = frozenset(corrected)
            repeats[[name in names for name in drives]] = config.hand_corrections.weight
        self._numbers = FrameNumbers.of_lengths(lengths, repeats, config.held_out, config.check_frames)
        self._order = FrameOrder(self._numbers.train, config.seed, config.shuffle)

    @property
    def train(self) -> int:
        """How many frames there are to train on."""
        return self._numbers.train

    @property
    def held_out(self) -> int:
        """How many held-out frames a check has."""
        return self._numbers.checked

    def number_at(self, index: int) -> int:
        """Return the number of the frame at an index of the order."""
        return self._order.frame_at(index)

    def unchanged(self, number: int) -> Sample:
        """Return a frame as it is, with the same points to learn features from each time."""
        return self._sample(self._scene(number), generator_at(number, self._config.seed))

    def augmented(self, index: int, pseudo_labels: Mapping[int, Boxes]) -> Sample:
        """Return the frame at an index of the order, with the random changes of that index.

        The objects that are pasted into it are from the frame after it, which is then in memory for the next index.
        """
        seed, augmentation = self._config.seed, self._config.augmentation
        rng, number = generator_at(index, seed), self.number_at(index)
        scene = self._scene(number)
        if number in pseudo_labels:
            more = pseudo_labels[number]
            scene = replace(
                scene,
                boxes=concat([scene.boxes, more], Boxes),
                velocity_mps=np.concatenate([scene.velocity_mps, np.zeros((len(more), 3))]),
            )
        donor = self._scene(self.number_at(index + 1)) if augmentation.pasted_objects else scene
        return self._sample(augment(scene, donor, augmentation, rng), rng)

    def _sample(self, scene: TrainingScene, rng: np.random.Generator) -> Sample:
        return scene.sample(self._grid, self._values, self._config.sampling, rng)

    def _read_scene(self, number: int) -> TrainingScene:
        drive, index = self._numbers.frame_of(number)
        source = self._source(self._drives[drive])
        frame = int(source.sweeps.trajectory.frame[index])
        boxes, velocity_mps = source.labels(frame)
        above_road = replace(boxes, center_m=boxes.center_m - [0.0, 0.0, source.sweeps.ground_z_m])
        return TrainingScene.of_frame(
            source.sweeps.points(index), *source.features(frame), above_road, velocity_mps
        )


def _most_open_drives() -> int:
    """Return how many drives can be open at once: fewer where the system allows a process few open files."""
    allowed, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return _OPEN_DRIVES if allowed < 0 else max(min(_OPEN_DRIVES, allowed // 2 // _FILES_OF_DRIVE), 8)
