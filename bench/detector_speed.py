"""How many frames a second the detector reads, and what the features of points cost of that.

A frame is 150 000 points of two sweeps, read alone, from points in memory to boxes and the features of the
points in them. On two threads of a processor, and on a GPU where there is one. Prints each figure beside its
bar and exits 1 when one is missed. The network is not trained: a trained one does the same work.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from upvl_cli.config.toml import load
from upvl_cli.detector.config import DecodeConfig, TrainConfig
from upvl_cli.detector.data.batch import Batch, Sample, collate
from upvl_cli.detector.decode import Detections, decode_output
from upvl_cli.detector.grid import Grid
from upvl_cli.detector.model import Detector, Output
from upvl_cli.detector.process_group import half_precision
from upvl_cli.geometry.boxes import pairs_inside

TRAIN = load(TrainConfig, Path(__file__).parents[1] / "stages" / "train.toml")
VIEW = replace(TRAIN.grid, z_min_m=-2.0, z_max_m=4.0)  # UP-VL's view, and the pillars that ship
GRID = Grid.of(VIEW)
BOX_CODERS = ("anchors", "centers")
POINTS = 150_000
DECODING = DecodeConfig(min_score=0.0, max_boxes=100, nms_iou=0.2, candidates_per_box=10)
LEAST_PER_S = {"cpu": 8.0, "cuda": 200.0}
MOST_SHARE = 0.05
RUNS = 20


def street(rng: np.random.Generator) -> np.ndarray:
    """Return (POINTS, 6) points, denser near the car as a spinning LiDAR sees them, half of an older sweep."""
    many = 4 * POINTS
    far, turn = rng.exponential(18.0, many), rng.uniform(-np.pi, np.pi, many)
    xyz = np.column_stack([far * np.cos(turn), far * np.sin(turn), rng.exponential(0.7, many)])
    xyz = xyz[GRID.contains(xyz)][:POINTS]
    rest = rng.uniform(size=(POINTS, 2)), np.repeat([0.0, -0.1], POINTS // 2)
    return np.column_stack([xyz, *rest]).astype(np.float32)


def best_seconds(works: list[Callable[[], object]], device: str) -> list[float]:
    """Return the shortest of some runs of each, in turns, so that a busy moment spares none; the first warms up."""
    seconds = np.zeros((RUNS + 1, len(works)))
    for run in seconds:
        for number, work in enumerate(works):
            start = time.perf_counter()
            work()
            if device == "cuda":
                torch.cuda.synchronize()
            run[number] = time.perf_counter() - start
    return seconds[1:].min(axis=0).tolist()


def report(name: str, figure: str, bar: str, passed: bool) -> bool:
    """Print one line and return whether the bar is met."""
    print(f"{name:<28} {figure:<30} bar {bar:<15} {'ok' if passed else 'MISSED'}", flush=True)
    return passed


@torch.inference_mode()
def measure(box_coder: str, width: int, device: str) -> list[bool]:
    """Report one network on one device."""
    torch.manual_seed(1)
    points = street(np.random.default_rng(1))
    config = replace(TRAIN.detector, grid=VIEW, model=replace(TRAIN.model, box_coder=box_coder, width=width))
    detector = Detector(config, True).to(device).eval()

    def read() -> tuple[Batch, Output, Detections]:
        batch = collate([Sample.from_points(points)], GRID).to(device)
        with half_precision(torch.device(device), enabled=True):
            output = detector(batch)
        return batch, output, decode_output(detector, output, DECODING)[0]

    batch, output, boxes = read()
    held = np.unique(pairs_inside(points[:, :3], boxes, margin_m=0.0)[1])
    rows = torch.from_numpy(held).to(device)
    # Without distillation the rest is the same network: features are computed only where they are asked for.
    boxes_s, features_s = best_seconds([read, lambda: detector.features(output, batch, rows).cpu()], device)
    whole_s, least = boxes_s + features_s, LEAST_PER_S[device]
    share = features_s / whole_s
    name = f"{box_coder} {width} {device}"
    return [
        report(f"{name}, frames", f"{1 / whole_s:.1f}/s", f">= {least:.0f}/s", 1 / whole_s >= least),
        report(
            f"{name}, features",
            f"{100 * share:.1f} % for {len(held)} points",
            f"< {100 * MOST_SHARE:.0f} %",
            share < MOST_SHARE,
        ),
    ]


def main() -> int:
    """Measure and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=16, help="channels of a pillar, as in train.toml")
    parser.add_argument("--threads", type=int, default=2, help="of the processor")
    chosen = parser.parse_args()
    torch.set_num_threads(chosen.threads)
    devices = ["cpu"] + ["cuda"] * torch.cuda.is_available()
    passed = [measure(box_coder, chosen.width, device) for device in devices for box_coder in BOX_CODERS]
    return 0 if all(sum(passed, [])) else 1


if __name__ == "__main__":
    raise SystemExit(main())
