"""How many frames a second the detector reads, and what the features of points cost of that.

A frame is 150 000 points of two sweeps, read alone, from points in memory to boxes and the features of the
points in them. On two threads of a processor, and on a GPU where there is one. Prints each figure beside its
bar and exits 1 when one is missed. The network is not trained: a trained one does the same work.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import torch

from upvl_cli.detector.batch import Batch, Grid, Sample, collate
from upvl_cli.detector.decode import detections
from upvl_cli.detector.model import HEADS, Detector, Output
from upvl_cli.detector.together import half_precision
from upvl_cli.geometry.boxes import pairs_inside

GRID = Grid((-50.0, 50.0), (-20.0, 20.0), (-2.0, 4.0), 0.24)  # UP-VL's view, and the pillars that ship
POINTS = 150_000
BOXES = 100
LEAST_PER_S = {"cpu": 8.0, "cuda": 200.0}
MOST_SHARE = 0.05
RUNS = 20


def street(rng: np.random.Generator) -> np.ndarray:
    """Return (POINTS, 6) points, denser near the car as a spinning LiDAR sees them, half of an older sweep."""
    many = 4 * POINTS
    far, turn = rng.exponential(18.0, many), rng.uniform(-np.pi, np.pi, many)
    xyz = np.column_stack([far * np.cos(turn), far * np.sin(turn), rng.exponential(0.7, many)])
    xyz = xyz[GRID.holds(xyz)][:POINTS]
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
def measured(encoder: str, width: int, device: str) -> list[bool]:
    """Report one network on one device."""
    torch.manual_seed(1)
    points = street(np.random.default_rng(1))
    detector = Detector(GRID, width, encoder, True).to(device).eval()

    def read() -> tuple[Batch, Output, np.ndarray]:
        batch = collate([Sample.of_points(points)], GRID).to(device)
        with half_precision(torch.device(device), wanted=True):
            output = detector(batch)
        found = detections(detector, output, min_score=0.0, max_boxes=BOXES, nms_iou=0.2)[0]
        return batch, output, found.seven

    batch, output, seven = read()
    held = np.unique(pairs_inside(points[:, :3], seven, margin_m=0.0)[1])
    rows = torch.from_numpy(held).to(device)
    # Without distillation the rest is the same network: features are computed only where they are asked for.
    boxes_s, features_s = best_seconds([read, lambda: detector.features(output, batch, rows).cpu()], device)
    whole_s, least = boxes_s + features_s, LEAST_PER_S[device]
    share = features_s / whole_s
    name = f"{encoder} {width} {device}"
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
    passed = [measured(encoder, chosen.width, device) for device in devices for encoder in HEADS]
    return 0 if all(sum(passed, [])) else 1


if __name__ == "__main__":
    raise SystemExit(main())
