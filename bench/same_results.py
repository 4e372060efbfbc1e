"""Compare what the pipeline makes with what it made before a change of structure, value by value.

    python bench/same_results.py ../shared/data/kitti_raw_b ../shared/data/kitti_raw_a [--only NAME] [--write]

Labels the two KITTI drives and the built-in drive as shipped, scores them, and prints for each table and column
the number of values and the largest difference of four figures (sum, sum of squares, least, largest) from those in
`bench/same_results.json`, relative to the largest value, and each score that is not equal to the printed digit.
Columns are compared by their names in the tables of now; `--write` writes the file anew, from a tree whose results
are to be kept. Exits 1 where a score differs or a figure differs by more than 1e-6.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from workspaces import on_city, on_kitti

REFERENCE = Path(__file__).with_suffix(".json")
TOLERANCE = 1e-6
KEYS = {"segment", "frame", "time_ns", "proposal", "camera"}
# What is labelled, and what is scored of it. A training on the built-in drive takes minutes: its steps are few.
RUNS = {
    "kitti_raw_b moving-only": (
        ["autolabel", "--moving-only"],
        ["eval", "--class-agnostic", "--moving-only"],
    ),
    "kitti_raw_b": (["autolabel", "--all-motion"], ["eval", "--by-class", "--all-motion"]),
    "kitti_raw_a": (["autolabel", "--all-motion"], ["eval", "--class-agnostic", "--all-motion"]),
    "built-in": (["autolabel", "--all-motion"], ["eval", "--by-class", "--all-motion"]),
}


def figures(path: Path) -> dict[str, list[float]]:
    """Return for each numeric column of a shard how many values it has, their sum, sum of squares, least and largest.

    Args:
        path: The shard. A column of bytes holds whole numbers of one byte.
    """
    found = {}
    for name, column in zip((table := pq.read_table(path)).column_names, table.columns, strict=True):
        values = np.concatenate([np.zeros(0), *map(_flat, column.chunks)])
        if name not in KEYS and len(values):
            finite = values.astype(np.float64)
            extent = [float(finite.min()), float(finite.max())]
            found[name] = [len(finite), float(finite.sum()), float(np.square(finite).sum()), *extent]
    return found


def _flat(chunk: Any) -> np.ndarray:
    """Return the numbers of a column: all those of its lists and bytes, none of its texts."""
    if str(chunk.type) == "binary":
        return np.concatenate(
            [np.zeros(0, np.int8), *(np.frombuffer(cell.as_py(), np.int8) for cell in chunk)]
        )
    while str(chunk.type).startswith(("list", "fixed_size_list")):
        chunk = chunk.flatten()
    return np.zeros(0) if str(chunk.type) == "string" else chunk.to_numpy(zero_copy_only=False)


def made(folder: Path, label: list[str], score: list[str]) -> dict[str, Any]:
    """Label and score the drives of a workspace; return the scores and the figures of every table."""
    upvl = str(Path(sys.executable).with_name("upvl"))
    subprocess.run([upvl, *label], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    subprocess.run([upvl, *score], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    scores = {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("out/eval/*.json"))}
    tables = {
        f"{path.parent.name}/{path.stem}": figures(path) for path in sorted(folder.glob("out/*/*.parquet"))
    }
    return {"scores": rounded(scores), "tables": tables}


def rounded(value: Any) -> Any:
    """Return scores to the digits that are printed."""
    if isinstance(value, dict):
        # Curves are long, and their averages are scores too.
        return {key: rounded(item) for key, item in value.items() if not key.startswith("curve")}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return round(value, 3) if isinstance(value, float) else value


def differences(before: dict[str, Any], now: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield each column with its largest difference; what is missing differs by infinity."""
    for table, columns in before["tables"].items():
        for name, old in columns.items():
            new = now["tables"].get(table, {}).get(name)
            if new is None or new[0] != old[0]:
                yield f"{table} {name}", float("inf")
                continue
            largest = max(abs(old[3]), abs(old[4]), 1e-12)
            scale = np.array([old[0] * largest, old[0] * largest**2, largest, largest])
            yield f"{table} {name}", float((np.abs(np.subtract(new, old)[1:]) / scale).max())


def unequal(before: Any, now: Any, name: str = "") -> Iterator[str]:
    """Yield the names of the scores that differ; settings of the evaluation are no scores."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key, item in before.items():
            if key != "settings":
                yield from unequal(item, now.get(key), f"{name}/{key}")
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for place, (old, new) in enumerate(zip(before, now, strict=True)):
            yield from unequal(old, new, f"{name}/{place}")
    elif before != now:
        yield f"{name}: {before} -> {now}"


def main() -> int:
    """Compare, print, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "kitti", nargs="+", type=Path, help="folders with the KITTI raw drives, named as above"
    )
    parser.add_argument("--only", choices=RUNS, help="make only this")
    parser.add_argument("--write", action="store_true", help="write the figures of now to the file")
    arguments = parser.parse_args()
    roots = {path.name: path for path in arguments.kitti}
    reference = json.loads(REFERENCE.read_text()) if REFERENCE.exists() else {}
    fine = True
    for name, (label, score) in RUNS.items():
        if arguments.only not in (None, name):
            continue
        with tempfile.TemporaryDirectory() as temporary:
            drive = name.split()[0]
            folder = (
                on_kitti(Path(temporary), roots[drive], []) if drive in roots else on_city(Path(temporary))
            )
            now = made(folder, label, score)
        if arguments.write:
            reference[name] = now
            continue
        wrong = list(unequal(reference[name]["scores"], now["scores"]))
        found = dict(differences(reference[name], now))
        fine &= not wrong and max(found.values()) <= TOLERANCE
        print(f"{name}: {len(found)} columns, largest difference {max(found.values()):.1e}")
        for line in wrong:
            print(f"  score {line}")
        for column, size in found.items():
            if size > TOLERANCE:
                print(f"  {column} {size:.1e}")
    if arguments.write:
        REFERENCE.write_text(json.dumps(reference, indent=1, sort_keys=True) + "\n")
    print("the same" if fine else "DIFFERENT")
    return 0 if fine else 1


if __name__ == "__main__":
    raise SystemExit(main())
