"""Whether results depend on the processor.

    python bench/portability.py [--kitti ROOT] [--keep FOLDER] [-- OPTION ...]

OpenBLAS picks the kernels of its matrix products by the processor, and each sums in an order of its own. Every stage
of `upvl autolabel` is run with each kernel that this processor can run, and its shards are compared with those of
the first one: a shard that a later stage computes from them may not hang on the machine either. Prints, for each
stage and kernel, the largest difference of each column that differs; `rows` where there are other rows.
The drives are those of ROOT; without, one of the built-in city, whose own points may differ in the last digit before
any stage has run: its rays are rotated through BLAS. Options after `--` go to `autolabel` (`--moving-only`).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.types import Array
from workspaces import on_city, on_kitti

KERNELS = ("Haswell", "Prescott", "Nehalem", "Sandybridge", "Zen", "SkylakeX", "Cooperlake")
PROBE = """
import numpy as np, threadpoolctl
square = np.random.default_rng(0).normal(size=(300, 300))
np.linalg.inv(square @ square)
print(threadpoolctl.threadpool_info()[0]["architecture"])
"""


def kernels(names: list[str]) -> dict[str, str]:
    """Return the kernels that run here: the name to ask for, by the one that OpenBLAS gives its answer."""
    found: dict[str, str] = {}
    for name in names:
        done = subprocess.run(
            [sys.executable, "-c", PROBE],
            env=os.environ | {"OPENBLAS_CORETYPE": name},
            capture_output=True,
            text=True,
        )
        if done.returncode == 0:  # a kernel whose instructions the processor lacks is killed
            found.setdefault(done.stdout.strip(), name)
    return found


def columns(table: pa.Table) -> Iterator[tuple[str, Array]]:
    """Yield the numbers of each column of a shard, lists laid end to end."""
    for name in table.column_names:
        column = table[name].combine_chunks()
        while pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
            column = column.flatten()
        yield name, column.to_numpy(zero_copy_only=False)


def differences(one: Path, two: Path) -> dict[str, str]:
    """Return the largest difference of each column in which two shards differ."""
    found = {}
    for (name, a), (_, b) in zip(columns(pq.read_table(one)), columns(pq.read_table(two)), strict=True):
        if len(a) != len(b):
            return {"rows": f"{len(a)} and {len(b)}"}
        if np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
            continue
        if a.dtype.kind in "fiu":
            found[name] = f"{np.nanmax(np.abs(a.astype(np.float64) - b.astype(np.float64))):.1e}"
        else:
            found[name] = f"{(a != b).sum()} of {len(a)}"
    return found


def _leading_number(text: str) -> float:
    return float(text.split()[0]) if text else -1.0


def label(folder: Path, kernel: str, options: list[str]) -> None:
    """Label the drives of a workspace with one kernel; one thread, so that the number of cores has no say."""
    upvl = Path(sys.executable).with_name("upvl")
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(
        [upvl, "autolabel", *options], cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path, help="folder of KITTI raw drives")
    parser.add_argument("--keep", type=Path, help="folder for the workspaces; a temporary one if not given")
    parser.add_argument("--frames", type=int, default=20, help="frames of the built-in drive")
    parser.add_argument("--kernels", nargs="+", default=list(KERNELS), help="as OPENBLAS_CORETYPE names them")
    parser.add_argument("options", nargs="*", help="of `upvl autolabel`")
    given = parser.parse_args()
    folder = given.keep or Path(tempfile.mkdtemp())
    names = kernels(given.kernels)
    print(f"kernels that run here: {', '.join(names)}", flush=True)
    for name, asked in names.items():
        here = folder / name
        if given.kitti:
            on_kitti(here, given.kitti, [])
        else:
            on_city(here, frames=given.frames, train=0, val=1)
        label(here, asked, given.options)
    first, *others = names
    made = [stage.name for stage in PIPELINE.stages if (folder / first / "out" / stage.name).is_dir()]
    for stage in made:
        for name in others:
            found: dict[str, str] = {}
            for shard in sorted((folder / first / "out" / stage).glob("*.parquet")):
                for column, size in differences(shard, folder / name / "out" / stage / shard.name).items():
                    found[column] = max(found.get(column, ""), size, key=_leading_number)
            print(
                f"{stage:14} {name:12} " + (", ".join(f"{k} {v}" for k, v in found.items()) or "same"),
                flush=True,
            )


if __name__ == "__main__":
    main()
