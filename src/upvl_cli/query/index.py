"""The search index: what filters and searches need of every stored object, in one memory-mapped file.

It is an uncompressed Arrow file with one batch a drive, in `out/query`. A drive whose shard has not changed since
is copied from the index before; nothing is read of the features of single points.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa

from upvl_cli.perception.visual.open_vocabulary import COMPONENTS
from upvl_cli.pipeline.tables import Table, footer_digest
from upvl_cli.query.store import Store, check_basis
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.runtime.parallel import in_order
from upvl_cli.stages.rows import ObjectSummaryRow
from upvl_cli.types import Array, ParallelArrays, array

DRIVES_KEY = b"upvl.drives"
T = TypeVar("T", bound=ParallelArrays)


@dataclass(frozen=True)
class Objects(ParallelArrays):
    """Objects of one drive, by frame and box.

    Attributes:
        frame: (n,) index of the frame.
        box: (n,) place of the box in its frame.
        track_id: (n,) number of the track, -1 for none.
        time_s: (n,) since the first frame of the drive.
        confidence: (n,) of the box itself, 0 to 1.
        points: (n,) points with a feature in the box.
        seven: (n, 7) the box, in ego axes.
        velocity_mps: (n, 3) over the ground along the ego axes.
        pooled: (n, COMPONENTS) mean feature, rounded.
    """

    frame: Array = array("int64")
    box: Array = array("int32")
    track_id: Array = array("int64")
    time_s: Array = array("float64")
    confidence: Array = array("float32")
    points: Array = array("int32")
    seven: Array = array("float32", 7)
    velocity_mps: Array = array("float32", 3)
    pooled: Array = array("int8", COMPONENTS)

    @property
    def range_m(self) -> Array:
        """(n,) distance from the car, over the ground."""
        return np.asarray(np.hypot(self.seven[:, 0], self.seven[:, 1]))

    @property
    def speed_mps(self) -> Array:
        """(n,) speed over the ground."""
        return np.asarray(np.hypot(self.velocity_mps[:, 0], self.velocity_mps[:, 1]))


def drives(store: Store) -> Iterator[tuple[str, Objects]]:
    """The objects of each drive, by name; the index is made or mended first where it has to be.

    The arrays are views of the file: what is not looked at is not read.

    Raises:
        NotMade: A shard is damaged, or was made with another basis than there is now.
    """
    digests = in_order(footer_digest, store.paths.values())
    wanted = {
        name: f"{digest} {store.basis_digest}" for name, digest in zip(store.paths, digests, strict=True)
    }
    batches = _stored(store.index)
    if list(batches) != list(wanted.items()):
        _write(store, wanted, batches)
        batches = _stored(store.index)
    for (name, _), batch in batches.items():
        yield name, Objects(**{spec.name: _view(batch.column(spec.name)) for spec in fields(Objects)})


def _stored(path: Path) -> dict[tuple[str, str], pa.RecordBatch]:
    """The batch of each drive, by name and digest of its shard and basis; none where the file is missing or damaged."""
    with suppress(OSError, pa.ArrowException, KeyError, ValueError):
        file = pa.ipc.open_file(pa.memory_map(str(path)))
        if file.schema.remove_metadata().equals(_schema({}).remove_metadata()):
            names = [(name, digest) for name, digest in json.loads(file.schema.metadata[DRIVES_KEY])]
            return {name: file.get_batch(place) for place, name in enumerate(names)}
    return {}


def _write(store: Store, wanted: dict[str, str], before: dict[tuple[str, str], pa.RecordBatch]) -> None:
    schema = _schema(wanted)
    with atomic_file(store.index) as file, pa.ipc.new_file(file, schema) as writer:
        for name, digest in wanted.items():
            kept = before.get((name, digest))
            if kept is None:
                check_basis(store, store.paths[name])
            columns = _columns(_read(store.paths[name])) if kept is None else kept.columns
            writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=schema))


def _read(path: Path) -> Objects:
    rows = Table(path, ObjectSummaryRow)
    found: list[Objects] = []
    start_ns: int | None = None
    for row in rows:
        start_ns = row.time_ns if start_ns is None else start_ns
        boxes = len(row.track_id)
        found.append(
            Objects(
                np.full(boxes, row.frame),
                np.arange(boxes),
                row.track_id,
                np.full(boxes, (row.time_ns - start_ns) * 1e-9),
                row.score,
                row.num_features,
                row.seven,
                row.velocity_mps,
                row.pooled,
            )
        )
    return joined(Objects, found)


def joined(kind: type[T], parts: list[T]) -> T:
    """Several tables of parallel arrays as one."""
    every = [kind(*([[]] * len(fields(kind)))), *parts]
    return kind(
        **{spec.name: np.concatenate([getattr(part, spec.name) for part in every]) for spec in fields(kind)}
    )


def _schema(wanted: dict[str, str]) -> pa.Schema:
    def kind(spec: Any) -> pa.DataType:
        item, shape = pa.from_numpy_dtype(np.dtype(spec.metadata["dtype"])), spec.metadata["shape"]
        return pa.list_(item, shape[0]) if shape else item

    columns = [pa.field(spec.name, kind(spec), nullable=False) for spec in fields(Objects)]
    return pa.schema(columns, {DRIVES_KEY: json.dumps(list(wanted.items())).encode()})


def _columns(objects: Objects) -> list[pa.Array]:
    columns = []
    for spec in fields(Objects):
        values = getattr(objects, spec.name)
        flat = pa.array(values.reshape(-1))
        columns.append(pa.FixedSizeListArray.from_arrays(flat, values.shape[1]) if values.ndim > 1 else flat)
    return columns


def _view(column: pa.Array) -> Array:
    if not pa.types.is_fixed_size_list(column.type):
        return np.asarray(column.to_numpy())
    return np.asarray(column.flatten().to_numpy().reshape(-1, column.type.list_size))
