"""The order of training frames at the size of a fleet's archive, and training by two processes against one.

    python bench/train_scale.py [--drives 1000000] [--frames 200] [--steps 12] [--skip-training]

Prints start-up time and memory of the numbering and order of the frames of so many drives (lengths are simulated, no
drive is read), seconds per index, distinct drives opened and bytes read per 1000 frames with a shuffle of all frames
and with windows of chunks; then the steps per second of a training on random points by `torchrun` with one process
and with two (gloo, one thread each). Exits with 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from upvl_cli.config.toml import load
from upvl_cli.detector.checkpoint import TrainState
from upvl_cli.detector.config import ShuffleConfig, TrainConfig
from upvl_cli.detector.data.batch import Sample
from upvl_cli.detector.data.numbers import FrameNumbers
from upvl_cli.detector.data.sampler import FrameOrder
from upvl_cli.detector.grid import Grid
from upvl_cli.detector.loss import FeatureSpace
from upvl_cli.detector.model import Detector
from upvl_cli.detector.process_group import process_group
from upvl_cli.detector.train import TrainSetup, train
from upvl_cli.types import Boxes

TRAIN = load(TrainConfig, Path(__file__).parents[1] / "stages" / "train.toml")
OPEN_DRIVES = 128
# Assumed of a drive of 20 s: footers and poses when it is opened, a sweep of 120 000 points, and a row group of
# features (`GROUP_BYTES` of pipeline/tables.py).
OPENING_BYTES, SWEEP_BYTES, FEATURE_GROUP_BYTES = 400_000, 2_400_000, 2_000_000
POINTS, BATCH = 60_000, 4
MOST_START_S, MOST_MIB, MOST_INDEX_US, MOST_OPENED = 5.0, 200.0, 200.0, 20.0


def main() -> int:
    """Measure and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=1_000_000)
    parser.add_argument("--frames", type=int, default=200, help="mean number of frames of a drive")
    parser.add_argument("--steps", type=int, default=12, help="steps of each training")
    parser.add_argument("--skip-training", action="store_true")
    parser.add_argument("--processor", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.processor:
        return take_steps(Path(given.processor), given.steps)
    passed = measure_order(given.drives, given.frames)
    if not given.skip_training:
        passed.append(measure_processes(given.steps))
    return 0 if all(passed) else 1


def report(name: str, figure: str, bar: str, passed: bool) -> bool:
    """Print one line and return whether the bar is met."""
    print(f"{name:<44} {figure:<34} bar {bar:<12} {'ok' if passed else 'MISSED'}", flush=True)
    return passed


def measure_order(drives: int, frames: int) -> list[bool]:
    """Report start-up, memory, seconds per index, and how many drives are opened."""
    lengths = np.random.default_rng(0).integers(frames // 2, frames + frames // 2 + 1, drives)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    numbers = FrameNumbers.of_lengths(lengths, np.ones(drives, np.int32), TRAIN.held_out, TRAIN.check_frames)
    order = FrameOrder(numbers.train, 0, TRAIN.shuffle)
    numbers.frame_of(order.frame_at(0))
    start_s = time.process_time() - start
    grown_mib = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    print(f"{drives} drives, {numbers.train} frames to train on, {numbers.checked} of a check")
    indices = range(numbers.train // 2, numbers.train // 2 + 50_000)
    start = time.process_time()
    for index in indices:
        numbers.frame_of(order.frame_at(index))
    index_us = (time.process_time() - start) / len(indices) * 1e6
    passed = [
        report("start-up", f"{start_s:.2f} CPU s", f"<= {MOST_START_S:.0f} s", start_s <= MOST_START_S),
        report("memory", f"{grown_mib:.0f} MiB", f"<= {MOST_MIB:.0f} MiB", grown_mib <= MOST_MIB),
        report("an index", f"{index_us:.0f} CPU us", f"<= {MOST_INDEX_US:.0f} us", index_us <= MOST_INDEX_US),
    ]
    print(f"{'chunk x window':<16} {'shuffled together':>18} {'drives per 1000':>16} {'GB per 1000':>12}")
    for chunk, window in ((1, numbers.train), (32, 256), (64, 128), (128, 64), (128, 256), (256, 32)):
        shuffle = ShuffleConfig(chunk_frames=chunk, window_chunks=min(window, numbers.train // chunk))
        if chunk == 1:  # a shuffle of all frames, without an array of them
            shuffle = ShuffleConfig(chunk_frames=1, window_chunks=1)
        at = FrameOrder(numbers.train, 0, shuffle)
        found = [numbers.frame_of(at.frame_at(index)) for index in indices[:20_000]]
        opened, gigabytes = cost(found)
        together = numbers.train if chunk == 1 else chunk * window
        name = f"{chunk} x {window}" if chunk > 1 else "all frames"
        print(f"{name:<16} {together:>18} {opened:>16.0f} {gigabytes:>12.2f}")
        if shuffle == TRAIN.shuffle:
            passed.append(
                report(
                    "drives opened for 1000 frames, as shipped", f"{opened:.0f}", f"<= {MOST_OPENED:.0f}",
                    opened <= MOST_OPENED,
                )
            )  # fmt: skip
    return passed


def cost(frames: Iterable[tuple[int, int]]) -> tuple[float, float]:
    """Return how many drives are opened and how many gigabytes are read from a store for 1000 frames.

    Drives stay open as in `DriveFrames`. Sweeps (this one and the one before) are kept by the cache of sweeps, 20 GB;
    row groups of features are read again.
    """
    held: OrderedDict[int, None] = OrderedDict()
    sweeps: OrderedDict[tuple[int, int], None] = OrderedDict()
    total = opened = size = 0
    for drive, index in frames:
        total += 1
        if drive not in held:
            opened, size = opened + 1, size + OPENING_BYTES
        held[drive] = held.pop(drive, None)
        if len(held) > OPEN_DRIVES:
            held.popitem(last=False)
        for key in [(drive, place) for place in (index, index - 1) if place >= 0]:
            if key not in sweeps:
                size += SWEEP_BYTES
            sweeps[key] = sweeps.pop(key, None)
            if len(sweeps) * SWEEP_BYTES > 20e9:
                sweeps.popitem(last=False)
        size += FEATURE_GROUP_BYTES
    return 1000 * opened / total, size / total / 1e6


class RandomFrames:
    """Frames of random points, as heavy as real ones."""

    train, held_out = 1000, 0

    def number_at(self, index: int) -> int:
        """Return the frame at an index."""
        return index % self.train

    def augmented(self, index: int, pseudo_labels: dict[int, Boxes]) -> Sample:
        """Return the frame at an index."""
        return self.unchanged(self.number_at(index))

    def unchanged(self, number: int) -> Sample:
        """Return a frame with two boxes, and features of 8192 points."""
        rng, grid = np.random.default_rng(number), Grid.of(TRAIN.grid)
        points = rng.uniform([-49, -19, 0, 0, 0, 0], [49, 19, 4, 1, 1, 0], (POINTS, 6)).astype(np.float32)
        points = points[grid.contains(points)]
        seen = np.arange(0, len(points), 8)
        boxes = Boxes.from_rows(np.array([[5.0, 3, 1, 4.5, 2, 1.6, 0.1], [-9, -4, 1, 5, 2, 1.6, 1.5]]))
        return Sample(points, boxes, seen, rng.normal(size=(len(seen), 64)).astype(np.float32))


def take_steps(out: Path, steps: int) -> int:
    """Train for some steps as one of the processes; the first writes the seconds of the steps after the first two."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    config = replace(TRAIN, steps=steps, batch=BATCH, check_steps=10**6, precision="full")
    space = FeatureSpace.from_basis(np.full(70, 0.1, np.float32), np.eye(64, 70, dtype=np.float32))
    times: list[float] = []
    with process_group() as group:
        setup = TrainSetup(Detector(config.detector, True), RandomFrames(), space, config, group)
        train(setup, TrainState(), save=lambda state: None, tick=lambda: times.append(time.perf_counter()))
        if group.rank == 0:
            out.write_text(json.dumps([times[-1] - times[1], len(times) - 2]))
    return 0


def measure_processes(steps: int) -> bool:
    """Report the steps per second of one process and of two, each on one core."""
    seconds = {}
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "UPVL_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        for processes in (1, 2):
            out = Path(folder) / f"{processes}.json"
            command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node"]
            command += [str(processes), __file__, "--processor", str(out), "--steps", str(steps)]
            subprocess.run(command, check=True, env=environment, capture_output=True)
            total_s, count = json.loads(out.read_text())
            seconds[processes] = total_s / count
            print(
                f"{processes} process(es): {seconds[processes]:.2f} s for a step of {BATCH} frames",
                flush=True,
            )
    gain = seconds[1] / seconds[2]
    return report("two processes against one", f"x{gain:.2f}", ">= x1.8", gain >= 1.8)


if __name__ == "__main__":
    raise SystemExit(main())
