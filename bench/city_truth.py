"""How exact the truth of the built-in city is, checked by other ways than those it is made by.

    python bench/city_truth.py [--seed 0]

Prints for each camera how LiDAR points that it sees agree with the pixels that they fall on: inside of
objects, within half a pixel at silhouettes, and there by their own pixel alone; and how far points of rigid
movers, moved by their true flow, lie off their object one sweep later. Without noise of ranges and leaves,
which are no error of the truth. Exits 1 when a bar is missed.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from city_checks import flow_residual_m, projection  # noqa: E402
from upvl_cli.synthetic.config import CityConfig  # noqa: E402
from upvl_cli.synthetic.dataset import City  # noqa: E402

FRAME = 10
MIN_INSIDE, MIN_SILHOUETTE, MAX_FLOW_M = 0.999, 0.98, 0.03


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    values = tomllib.loads((ROOT / "stages" / "synthetic.toml").read_text())
    settings = replace(CityConfig(**values), seed=arguments.seed, noise=0.0)
    drive = City(settings).open("train-000")
    missed = False
    print(f"{'camera':12} {'points':>8} {'inside':>8} {'silhouettes':>12} {'own pixel':>10}")
    for camera in drive.cameras:
        found = projection(drive, FRAME, camera)
        print(
            f"{camera.name:12} {found.points:8,} {found.inner:8.4f} {found.silhouette:12.4f} {found.strict:10.4f}"
        )
        missed |= found.inner < MIN_INSIDE or found.silhouette < MIN_SILHOUETTE
    off_m = flow_residual_m(drive, FRAME)
    print(
        f"flow: {len(off_m):,} points of rigid movers, off by {np.median(off_m) * 1000:.2f} mm in the median, "
        f"{np.quantile(off_m, 0.99) * 1000:.1f} mm at 99 %, {off_m.max() * 1000:.1f} mm at most"
    )
    sys.exit(missed or np.quantile(off_m, 0.99) > MAX_FLOW_M)


if __name__ == "__main__":
    main()
