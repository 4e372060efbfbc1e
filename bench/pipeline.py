"""Time and peak memory of moving-only labelling: of the whole command, and stage by stage in processes of their own.

    python bench/pipeline.py ../shared/data/kitti_raw_b [--keep FOLDER]

Prints a row a stage, of which each starts Python and loads its libraries, and then what users run:
`upvl autolabel --moving-only` as a whole, in frames a second. Beside it stands the time of a plain
reference in the same run (scikit-learn's DBSCAN, radius 1 m, on the 0.2 m voxels of the middle sweep),
because machines are noisy: compare the ratio. Exits 1 below 2 frames a second or above 3 GiB.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from sklearn.cluster import DBSCAN

from upvl_cli.cli.labels import MOVING_ONLY
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.pipeline.presets import note_preset
from upvl_cli.pipeline.workspace import Workspace
from workspaces import on_kitti

MIN_FRAMES_PER_S = 2.0
MAX_PEAK_MIB = 3 * 1024


def measured(arguments: list[str], folder: Path) -> tuple[float, float, float]:
    """Wall seconds, CPU seconds and peak MiB of one command over all drives of a workspace."""
    command = [str(Path(sys.executable).with_name("upvl")), *arguments]
    started = time.perf_counter()
    child = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    if status:
        sys.exit(f"{' '.join(command)} failed in {folder}")
    return time.perf_counter() - started, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def reference_s(xyz_m: np.ndarray) -> float:
    """Seconds of the plain reference on one sweep."""
    voxels = np.unique(np.floor(xyz_m / 0.2).astype(np.int32), axis=0) * 0.2
    started = time.perf_counter()
    DBSCAN(eps=1.0, min_samples=10).fit(voxels)
    return time.perf_counter() - started


def _print_row(name: str, figures: tuple[float, float, float], frames: int) -> None:
    wall_s, cpu_s, peak_mib = figures
    print(f"{name:10} {wall_s:8.2f} {cpu_s:8.2f} {wall_s / frames:8.3f} {peak_mib:9.0f}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("root", type=Path, help="folder with KITTI raw drives")
    parser.add_argument("--keep", type=Path, help="make the workspace here and keep it")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = on_kitti(arguments.keep or Path(temporary), arguments.root, [])
        workspace = Workspace(PIPELINE, folder / "stages", folder / "out", MOVING_ONLY)
        note_preset(workspace)
        drives = [workspace.dataset.open(name) for name in workspace.segments]
        frames = sum(len(drive.frames) for drive in drives)
        sweep = drives[0].points(drives[0].frames[len(drives[0].frames) // 2].index)
        plain_s = min(reference_s(sweep.xyz_ego_m) for _ in range(3))
        print(f"{frames} frames; plain DBSCAN of one sweep: {plain_s:.3f} s")
        print(f"{'stage':10} {'wall s':>8} {'cpu s':>8} {'s/frame':>8} {'peak MiB':>9}")
        for stage in PIPELINE.labelling_stages:
            _print_row(stage.name, measured([stage.name], folder), frames)
        shutil.rmtree(folder / "out")
        whole = measured(["autolabel", "--moving-only"], folder)
        _print_row("autolabel", whole, frames)
    total_s, _, peak_mib = whole
    rate = frames / total_s
    print(
        f"{rate:.2f} frames/s, {total_s / frames / plain_s:.2f} x plain DBSCAN a frame, peak {peak_mib:.0f} MiB"
    )
    sys.exit(rate < MIN_FRAMES_PER_S or peak_mib > MAX_PEAK_MIB)


if __name__ == "__main__":
    main()
