"""How exactly Waymo segments are read: python bench/waymo_points.py DATASET_DIR EXPECTED_NPZ.

Compares v2 (DATASET_DIR) and v1 (DATASET_DIR/v1, where it is there) with the points and pixels that the npz expects,
and the boxes with the component `lidar_box`, read plainly. Prints the largest differences; exits 1 where a bound is
missed: 1 mm, 0.1 pixel, everything else exact.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from upvl_cli.datasets.waymo.dataset import Waymo
from upvl_cli.datasets.waymo.drive import WaymoDrive
from upvl_cli.datasets.waymo.labels import WaymoLabels
from upvl_cli.datasets.waymo.names import CAMERAS
from upvl_cli.types import Array, Labels

BOUNDS = {"points [m]": 1e-3, "pixels [px]": 0.1}  # of the rest: 0
BOX = "[LiDARBoxComponent]."


def main() -> None:
    """Print the differences; exits 1 where a bound is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", type=Path)
    parser.add_argument("expected", type=Path)
    options = parser.parse_args()
    expected = dict(np.load(options.expected))
    missed = False
    roots = {"v2": options.root, "v1": options.root / "v1"}
    for name, root in roots.items():
        if not root.is_dir():
            print(f"{name}: {root} is not there")
            continue
        waymo = Waymo(root)
        for segment in waymo.segments:
            drive, labels = waymo.open(segment), WaymoLabels(root).labels(segment)
            worst = {
                **sweep_differences(drive, expected),
                "boxes": box_difference(drive, labels, options.root),
            }
            print(f"{name} {segment}: {len(drive.frames)} frames, {len(labels)} boxes")
            for what, difference in worst.items():
                bound = BOUNDS.get(what, 0.0)
                missed |= not difference <= bound
                print(f"  {what}: {difference:.3g} (bound {bound:g})")
    sys.exit(missed)


def sweep_differences(drive: WaymoDrive, expected: dict[str, Array]) -> dict[str, float]:
    """Return the largest difference of each quantity over all frames; infinite where something is missing."""
    worst = dict.fromkeys(
        ("times [us]", "poses", "points [m]", "intensity", "elongation", "zones", "pixels [px]"), 0.0
    )

    def note(what: str, found: Array, wanted: Array) -> None:
        same_shape = np.shape(found) == np.shape(wanted)
        difference = np.abs(np.subtract(found, wanted, dtype=np.float64)) if same_shape else np.array(np.inf)
        worst[what] = max(worst[what], float(difference.max(initial=0.0)))

    assert drive.world_from_ego is not None
    note("times [us]", len(drive.frames), len({key.partition("/")[0] for key in expected}))
    for frame, pose in zip(drive.frames, drive.world_from_ego, strict=True):
        if f"{frame.index}/timestamp_us" not in expected:
            continue
        note("times [us]", frame.time_ns / 1000, expected[f"{frame.index}/timestamp_us"])
        note("poses", pose, expected[f"{frame.index}/world_from_vehicle"])
        projections, seen = [], set()
        for item in drive.returns(frame.index):
            prefix = f"{frame.index}/laser{item.laser}/return{item.return_number}/"
            if f"{prefix}xyz" not in expected:
                worst["points [m]"] = np.inf
                continue
            seen.add(prefix)
            note("points [m]", item.xyz_ego_m, expected[f"{prefix}xyz"])
            note("intensity", item.intensity, expected[f"{prefix}intensity"])
            note("elongation", item.elongation, expected[f"{prefix}elongation"])
            note("zones", item.in_no_label_zone, expected[f"{prefix}nlz"])
            projections.append(expected[f"{prefix}proj"])
        wanted = {
            key.removesuffix("xyz")
            for key in expected
            if key.startswith(f"{frame.index}/laser") and key.endswith("xyz")
        }
        note("points [m]", len(seen), len(wanted))
        stacked = np.concatenate([item.xyz_ego_m for item in drive.returns(frame.index)])
        note("points [m]", drive.points(frame.index).xyz_ego_m, stacked)
        note_pixels(drive, frame.index, np.concatenate(projections), note)
    return worst


def note_pixels(drive: WaymoDrive, frame: int, projections: Array, note: object) -> None:
    """Compare the pixels of each camera with the camera projections that are expected."""
    assert callable(note)
    for number, name in CAMERAS.items():
        wanted = np.full((len(projections), 2), np.nan)
        for first in (3, 0):
            seen = projections[:, first] == number
            wanted[seen] = projections[seen, first + 1 : first + 3]
        found = drive.pixels(frame, name)
        found = np.zeros((0, 2)) if found is None else found
        note("pixels [px]", np.isfinite(found), np.isfinite(wanted))
        note("pixels [px]", np.nan_to_num(found), np.nan_to_num(wanted))


def box_difference(drive: WaymoDrive, labels: Labels, root: Path) -> float:
    """Return the largest difference of any number of a box to the component lidar_box."""
    rows = pq.read_table(next((root / "lidar_box").glob("*.parquet"))).to_pylist()
    index = {stamp: frame for frame, stamp in drive.timestamps_us.items()}
    assert drive.world_from_ego is not None
    poses = dict(zip(index.values(), drive.world_from_ego, strict=True))
    found = {
        (int(frame), str(name)): number
        for number, (frame, name) in enumerate(zip(labels.frame, labels.object_id, strict=True))
    }
    wanted = {(index[row["key.frame_timestamp_micros"]], row["key.laser_object_id"]): row for row in rows}
    if found.keys() != wanted.keys():
        return np.inf
    worst = 0.0
    for key, row in wanted.items():
        label = labels[found[key] : found[key] + 1]
        box = [row[f"{BOX}box.{part}.{axis}"] for part in ("center", "size") for axis in "xyz"]
        velocity = poses[key[0]][:3, :3].T @ [row[f"{BOX}speed.{axis}"] for axis in "xyz"]
        numbers = [*box, row[f"{BOX}box.heading"], row[f"{BOX}type"], row[f"{BOX}num_lidar_points_in_box"]]
        numbers.append(row[f"{BOX}difficulty_level.detection"] or 0)
        ours = [*label.to_rows()[0], label.type[0], label.num_points[0], label.difficulty[0]]
        worst = max(worst, float(np.abs(np.subtract(ours, numbers)).max()))
        off_mps = float(np.abs(label.velocity_mps[0] - velocity).max())
        worst = max(worst, off_mps if off_mps > 1e-12 else 0.0)  # another order of the same sums
    return worst


if __name__ == "__main__":
    main()
