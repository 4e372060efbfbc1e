"""How fast `extract-vl` is on a real drive: python bench/vl_speed.py ../shared/data/kitti_raw_a.

Prints pictures a second and the peak memory of the stage in a process of its own, start and loading of the network
included, and how many the network alone does in the same run, on as many threads; also how far `--dry-run` was off.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from machine import Stolen
from upvl_cli.runtime.parallel import in_order
from upvl_cli.vlm.mini import Mini
from workspaces import make, on_kitti

PICTURES = 32


def main() -> None:
    """Run and print; exits 1 below 4 pictures a second or above 2 GiB."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = on_kitti(Path(scratch), options.root, [])
        make(folder, "odometry", "ground", "flow", "pca")
        upvl = Path(sys.executable).with_name("upvl")
        said = subprocess.run(
            [upvl, "extract-vl", "--dry-run"], cwd=folder, check=True, capture_output=True, text=True
        )
        stolen = Stolen()
        make(folder, "extract-vl")
        print(stolen)
        run = [json.loads(line) for line in (folder / "out" / "runs.jsonl").read_text().splitlines()][-1]
        size = sum(path.stat().st_size for path in (folder / "out" / "extract-vl").glob("*.parquet"))
    foretold = float(said.stdout.splitlines()[-1].split()[1]) * 1e6
    model, picture = Mini(), np.random.default_rng(0).integers(0, 255, (375, 1242, 3), dtype=np.uint8)
    model.embed_image(picture)
    started = time.perf_counter()
    for _ in in_order(model.embed_image, [picture] * PICTURES):
        pass
    alone = PICTURES / (time.perf_counter() - started)
    rate = run["rows"] / run["seconds"]
    print(f"{rate:.2f} pictures/s (bar 4) at 1242 x 375, peak {run['peak_mib']} MiB (bar 2048)")
    print(f"the network alone {alone:.2f} pictures/s: {rate / alone:.2f} of its speed")
    print(
        f"--dry-run said {foretold / 1e6:.1f} MB, it became {size / 1e6:.1f} MB ({foretold / size - 1:+.1%})"
    )
    sys.exit(not (rate >= 4 and run["peak_mib"] <= 2048))


if __name__ == "__main__":
    main()
