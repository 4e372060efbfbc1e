"""The run log as arrays: sums over the shards of an archive, of which single records would not fit into memory."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from upvl_cli.pipeline.catalog.hashing import Hashes, text_hashes
from upvl_cli.pipeline.run_log import records_of, run_blocks
from upvl_cli.types import Floats

NUMBERS = ("rows", "seconds", "cpu_s", "gpu_s", "peak_mib", "size_bytes", "end")
_TEXTS = ("stage", "segment")
_SCHEMA = pa.schema([*((name, pa.string()) for name in _TEXTS), *((name, pa.float64()) for name in NUMBERS)])
# The lines that `log_run` writes, when no name needs an escape.
_NUMBER = r"([\d.e+-]+)"
_LINE = re.compile(
    (
        r'^\{"stage": "([^"\\]*)", "segment": "([^"\\]*)", "rows": (\d+), '
        rf'"seconds": {_NUMBER}(?:, "cpu_s": {_NUMBER})?, "gpu_s": {_NUMBER}(?:, "peak_mib": {_NUMBER})?'
        rf'(?:, "size_bytes": (\d+))?, "read_bytes": \d+, "host": "[^"\\]*", "end": {_NUMBER}, '
        r'"settings": "[^"\\]*"\}$'
    ).encode(),
    re.MULTILINE,
)


@dataclass(frozen=True)
class StageRuns:
    """The last run of each shard of one stage.

    Attributes:
        segment_hash: (n,) hash of the name of the drive.
        numbers: (n, 7) values of `NUMBERS`; NaN where the log does not hold it.
        runs: Number of all runs, those that were made again later included.
        all_cpu_s: Processor time of all runs; elapsed time where the log does not hold it.
    """

    segment_hash: Hashes
    numbers: Floats
    runs: int
    all_cpu_s: float

    def column(self, name: str) -> Floats:
        """Return the (n,) values of one of `NUMBERS`."""
        found: Floats = self.numbers[:, NUMBERS.index(name)]
        return found

    @property
    def cpu_s(self) -> Floats:
        """(n,) processor time; elapsed time where the log does not hold it."""
        return _cpu_s(self.numbers)

    def of_segments(self, names: Iterable[str]) -> StageRuns:
        """Return the runs of the drives of these names."""
        known = np.isin(self.segment_hash, text_hashes(pa.array(list(names), pa.string())))
        return StageRuns(self.segment_hash[known], self.numbers[known], self.runs, self.all_cpu_s)


def stage_runs(out: Path) -> dict[str, StageRuns]:
    """Return the last runs of each stage.

    Args:
        out: Folder of the shards.
    """
    hashes: defaultdict[str, list[Hashes]] = defaultdict(list)
    numbers: defaultdict[str, list[Floats]] = defaultdict(list)
    for table in map(_table_of, run_blocks(out)):
        stages = table["stage"].combine_chunks().dictionary_encode()
        segment_hashes = text_hashes(table["segment"].combine_chunks())
        columns = np.column_stack([table[name].to_numpy() for name in NUMBERS])
        for code, stage in enumerate(stages.dictionary.to_pylist()):
            rows = np.flatnonzero(stages.indices.to_numpy() == code)
            hashes[stage].append(segment_hashes[rows])
            numbers[stage].append(columns[rows])
    return {
        stage: _last(np.concatenate(hashes.pop(stage)), np.concatenate(numbers.pop(stage)))
        for stage in list(hashes)
    }


def _last(segment_hash: Hashes, numbers: Floats) -> StageRuns:
    """Return the run of each drive that ended last; of those that ended at once the last in the log."""
    order = np.lexsort((np.nan_to_num(numbers[:, NUMBERS.index("end")]), segment_hash))
    sorted_hashes = segment_hash[order]
    is_last = np.append(sorted_hashes[1:] != sorted_hashes[:-1], True)
    chosen = order[is_last]
    return StageRuns(segment_hash[chosen], numbers[chosen], len(order), float(_cpu_s(numbers).sum()))


def _cpu_s(numbers: Floats) -> Floats:
    cpu_s, seconds = (numbers[:, NUMBERS.index(name)] for name in ("cpu_s", "seconds"))
    return np.where(np.isnan(cpu_s), seconds, cpu_s)


def _table_of(block: bytes) -> pa.Table:
    """Return some lines as a table: at once where all have the usual form, else one by one.

    Arrow's own reader of JSON is not used: lines that a kill cut short, or that somebody made, end the process.
    """
    found = _LINE.findall(block)
    try:
        if len(found) == sum(1 for line in block.split(b"\n") if line.strip()):
            texts = [
                pa.array([line[place] for line in found], pa.binary()).cast(pa.string()) for place in (0, 1)
            ]
            numbers = [
                np.array([line[place] or b"nan" for line in found], "S").astype(float)
                for place in range(2, 9)
            ]
            return pa.table([*texts, *numbers], schema=_SCHEMA)
    except (pa.ArrowException, ValueError):
        pass  # a name that is no text, or a number that is none
    rows = [{name: getattr(record, name) for name in _SCHEMA.names} for record in records_of(block)]
    return pa.Table.from_pylist(rows, schema=_SCHEMA)
