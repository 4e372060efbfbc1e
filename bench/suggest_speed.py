"""How fast `upvl words --suggest` is on a large fleet: python bench/suggest_speed.py [--tracks 100000].

Clusters made-up tracks of 60 kinds, whose sizes fall as 1 / k, and compares them with the kinds.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command has it
import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS
from upvl_cli.query.clusters import cluster, neighbor_distances
from upvl_cli.query.config import QueryConfig
from workspaces import ROOT

KINDS, NOISE = 60, 0.03
BAR_S = 10.0


def main() -> None:
    """Make, cluster, print; exits 1 where the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tracks", type=int, default=100_000)
    options = parser.parse_args()
    config = load(QueryConfig, ROOT / "stages" / "query.toml").suggest
    rng = np.random.default_rng(0)
    share = 1 / np.arange(1, KINDS + 1)
    kind = rng.choice(KINDS, options.tracks, p=share / share.sum())
    centres = rng.normal(size=(KINDS, COMPONENTS + 1))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    vectors = centres[kind] + rng.normal(0, NOISE, (options.tracks, COMPONENTS + 1))
    vectors = (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)
    started = time.process_time()
    apart = 2 * np.quantile(neighbor_distances(vectors), config.neighbor_quantile)
    number = cluster(vectors, apart, max_groups=config.max_groups)
    taken_s = time.process_time() - started
    pairs = len(np.unique(np.stack([number, kind], axis=1), axis=0))
    print(
        f"{options.tracks:,} tracks of {len(np.unique(kind))} kinds: {number.max() + 1} clusters, {pairs} pairs of "
        f"cluster and kind, in {taken_s:.1f} s of CPU (bar {BAR_S:g})"
    )
    raise SystemExit(taken_s > BAR_S)


if __name__ == "__main__":
    main()
