"""Scene flow of one real pair of sweeps, and of labelled drives by object: errors, time and memory.

    python bench/flow.py [--pair ../shared/data/flow_pair_a/pair.npz] [--slow] [--city [SENSOR ...]]
        [--drive kitti=../shared/data/kitti_raw_b] [--drive parquet=../shared/data/lyft] [--work FOLDER]

Prints a row for no motion at all, one for a plain reference in the same run (scikit-learn's DBSCAN of radius
1 m over the 0.2 m voxels of both sweeps, rigid ICP a cluster from zero and from the shift of its centre, kept
where the distance to the other sweep drops by a fifth), and one for `flow`; with --slow also one for each of its
methods `nsfp++` and `nsfp`; each in a process of its own. Machines are noisy: compare the ratio of CPU seconds.
Exits 1 where `flow` is worse than the reference in three-way EPE by more than a millimetre.

With `--city` and `--drive` the stage runs on drives of the made-up city, under each sensor preset that is named,
and on labelled real drives: a row for each with the share of moving objects of 30 points or more whose mean flow
is right (within 20 % or 0.1 m an interval), by range and speed, and of standing ones that are called moving.

A pair is an npz of `pc0` (n, 3) and `pc1` (m, 3) in one set of axes without ego motion and without ground,
`dt` (s), `gt_flow` (n, 3) in metres an interval, `gt_flow_total` (with ego motion), `classes` (0 is
background), `is_dynamic`, `is_valid`, `is_close`, `is_ground`.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from sklearn.cluster import DBSCAN

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.config.toml import load
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.flow_objects import labelled_flow_score
from upvl_cli.geometry.se3 import apply
from upvl_cli.metrics.flow import FlowErrors, flow_errors
from upvl_cli.perception.flow.rigid import estimate_rigid_flow
from upvl_cli.perception.flow.sweeps import OtherSweep
from upvl_cli.perception.registration.config import YawIcpConfig
from upvl_cli.perception.registration.icp import align_yaw
from upvl_cli.perception.voxels import voxelize
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.flow import FlowConfig
from workspaces import make, on_city, on_drives

ROOT = Path(__file__).parents[1]
PAIR = ROOT.parent / "shared" / "data" / "flow_pair_a" / "pair.npz"
WORSE_M = 0.001
SAMPLE = 500  # points of a cluster that the reference aligns
RUNS = 3
ICP = YawIcpConfig(radius_m=1.5, max_iterations=30, tolerance_m=1e-3)

Method = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


class Measured(NamedTuple):
    """What one method reached: errors, seconds of its best run, and memory of its process."""

    errors: FlowErrors
    wall_s: float
    cpu_s: float
    peak_mib: float


def no_motion(source_m: np.ndarray, target_m: np.ndarray, dt_s: float) -> np.ndarray:
    """Return no motion."""
    return np.zeros_like(source_m)


def plain(source_m: np.ndarray, target_m: np.ndarray, dt_s: float) -> np.ndarray:
    """Fit one rigid motion to each cluster, with constants set beforehand."""
    voxels = voxelize(np.concatenate([source_m, target_m]), voxel_m=0.2)
    found = DBSCAN(eps=1.0, min_samples=10).fit(voxels.centroid, sample_weight=voxels.weight).labels_
    of_source, of_target = np.split(found[voxels.of_point], [len(source_m)])
    flow_m = np.zeros_like(source_m)
    for label in range(found.max() + 1):
        mine, other = source_m[of_source == label], target_m[of_target == label]
        if len(mine) < 5 or len(other) < 5:
            continue
        a = mine[:: -(-len(mine) // SAMPLE)]
        shift = np.eye(4)
        shift[:3, 3] = other.mean(axis=0) - mine.mean(axis=0)
        fits = [align_yaw(a, other, start, ICP).target_from_source for start in (np.eye(4), shift)]
        tree = cKDTree(other)
        off_m = [tree.query(apply(motion, a))[0].mean() for motion in (np.eye(4), *fits)]
        best = int(np.argmin(off_m))
        if best and off_m[best] < 0.8 * off_m[0]:
            flow_m[of_source == label] = apply(fits[best - 1], mine) - mine
    return flow_m


def shipped(source_m: np.ndarray, target_m: np.ndarray, dt_s: float) -> np.ndarray:
    """Run the stage's algorithm with the values of `stages/flow.toml`."""
    config = load(FlowConfig, ROOT / "stages" / "flow.toml").rigid
    return estimate_rigid_flow(source_m, [OtherSweep(target_m, dt_s)], config) * dt_s


def nsfp_plus_plus(source_m: np.ndarray, target_m: np.ndarray, dt_s: float) -> np.ndarray:
    """Run NSFP++ with the values of `stages/flow.toml`."""
    from upvl_cli.perception.flow.nsfp.nsfp_plus_plus import estimate_nsfp_plus_plus_flow

    config = load(FlowConfig, ROOT / "stages" / "flow.toml").nsfp_pp
    return estimate_nsfp_plus_plus_flow(source_m, target_m, dt_s, config) * dt_s


def nsfp(source_m: np.ndarray, target_m: np.ndarray, dt_s: float) -> np.ndarray:
    """Run NSFP with the values of `stages/flow.toml`."""
    from upvl_cli.perception.flow.nsfp.nsfp import estimate_nsfp_flow

    config = load(FlowConfig, ROOT / "stages" / "flow.toml").nsfp
    return estimate_nsfp_flow(source_m, target_m, dt_s, config) * dt_s


METHODS: dict[str, Method] = {
    "no motion": no_motion,
    "plain reference": plain,
    "flow": shipped,
    "nsfp++": nsfp_plus_plus,
    "nsfp": nsfp,
}
SLOW = ("nsfp++", "nsfp")  # run with --slow, and once


def measured(name: str, path: Path) -> Measured:
    """Run a method on a pair."""
    pair = np.load(path)
    keep0, keep1 = ~pair["is_ground"], ~pair["is_ground1"] if "is_ground1" in pair else slice(None)
    source_m, target_m = pair["pc0"][keep0].astype(np.float64), pair["pc1"][keep1].astype(np.float64)
    seconds = []
    for _ in range(1 if name in SLOW else RUNS):
        started, cpu = time.perf_counter(), time.process_time()
        found_m = METHODS[name](source_m, target_m, float(pair["dt"]))
        seconds.append((time.perf_counter() - started, time.process_time() - cpu))
    flow_m = np.zeros(pair["pc0"].shape)
    flow_m[keep0] = found_m
    errors = flow_errors(
        flow_m,
        pair["gt_flow"],
        true_total_m=pair["gt_flow_total"],
        foreground=pair["classes"] > 0,
        dynamic=pair["is_dynamic"],
        evaluated=pair["is_valid"] & ~pair["is_ground"] & pair["is_close"],
    )
    wall_s, cpu_s = np.min(seconds, axis=0)
    return Measured(errors, wall_s, cpu_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pair", type=Path, default=PAIR, help="an npz as described above")
    parser.add_argument("--slow", action="store_true", help="measure the networks too: minutes")
    parser.add_argument(
        "--city", nargs="*", metavar="SENSOR", help="drives of the city, under these sensor presets if any"
    )
    parser.add_argument(
        "--drive", action="append", default=[], metavar="DATASET=ROOT", help="labelled drives of a dataset"
    )
    parser.add_argument("--work", type=Path, help="folder of the workspaces, kept for the next run")
    arguments = parser.parse_args()
    worse = pair_table(arguments.pair, slow=arguments.slow)
    with tempfile.TemporaryDirectory() as scratch:
        work = arguments.work or Path(scratch)
        folders = [(f"city {name}".strip(), city(work, name)) for name in arguments.city or [""]]
        if arguments.city is None:
            folders = []
        for drive in arguments.drive:
            dataset, root = drive.split("=", 1)
            folder = on_drives(work / f"{dataset}-{Path(root).name}", dataset, Path(root), [])
            folders.append((f"{dataset} {Path(root).name}", folder))
        for name, folder in folders:
            make(folder, "odometry", "ground", "flow")
            object_row(name, folder)
    sys.exit(worse)


def city(work: Path, sensor: str) -> Path:
    """Make a workspace of the city under a sensor preset; none is named by nothing."""
    return on_city(work / f"city-{sensor or 'default'}", **({"sensor": json.dumps(sensor)} if sensor else {}))


def object_row(name: str, folder: Path) -> None:
    """Print the score of the flow of labelled objects in a workspace."""
    settings = load(EvalConfig, folder / "stages" / "eval.toml")
    score = labelled_flow_score(Workspace(PIPELINE, folder / "stages", folder / "out"), settings)
    moving = ", ".join(f"{share.name} {share.right:.3f} of {share.objects}" for share in score.moving)
    print(
        f"{name}: moving objects right: {moving}; speed off by {score.speed_error_mps:.2f} m/s; "
        f"{score.standing_objects} standing: {score.called_moving:.4f} called moving, "
        f"{score.points_called_moving:.4f} of their points"
    )


def pair_table(path: Path, *, slow: bool) -> bool:
    """Print the table of a pair; return whether `flow` is worse than the reference."""
    rows = {}
    print(
        f"{'method':16} {'3-way EPE m':>11} {'dynamic':>8} {'relaxed':>8} {'dyn IoU':>8} {'false':>7}", end=""
    )
    print(f" {'wall s':>7} {'cpu s':>7} {'peak MiB':>9}")
    for name in [name for name in METHODS if slow or name not in SLOW]:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            rows[name] = row = alone.submit(measured, name, path).result()
        errors = row.errors
        print(
            f"{name:16} {errors.three_way_epe_m:11.4f} {errors.dynamic_epe_m:8.4f} {errors.relaxed:8.3f} "
            f"{errors.dynamic_iou:8.3f} {errors.background_epe_m:7.4f} "
            f"{row.wall_s:7.3f} {row.cpu_s:7.3f} {row.peak_mib:9.0f}"
        )
    ours, reference = rows["flow"], rows["plain reference"]
    print(
        f"flow takes {ours.cpu_s / reference.cpu_s:.2f} x the CPU time of the reference, with "
        f"{ours.errors.three_way_epe_m / reference.errors.three_way_epe_m:.2f} x its three-way EPE and "
        f"{ours.errors.dynamic_epe_m / reference.errors.dynamic_epe_m:.2f} x its dynamic EPE"
    )
    if slow:
        local, base = rows["nsfp++"], rows["nsfp"]
        print(
            f"nsfp takes {base.cpu_s / local.cpu_s:.1f} x the CPU time of nsfp++, with "
            f"{base.errors.three_way_epe_m / local.errors.three_way_epe_m:.2f} x its three-way EPE"
        )
    return bool(ours.errors.three_way_epe_m > reference.errors.three_way_epe_m + WORSE_M)


if __name__ == "__main__":
    main()
