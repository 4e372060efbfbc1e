"""The search index: what filters and rankings need of every stored box, in one memory-mapped file.

It is an uncompressed Arrow file with one batch a drive, in `out/query`. The batch of a drive whose shard and basis have
not changed is copied from the index before; the features of single points are never read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from upvl_cli.perception.visual.open_vocabulary import COMPONENTS
from upvl_cli.pipeline.tables import Table, footer_digest
from upvl_cli.query.store import Store, check_basis
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.runtime.parallel import in_order
from upvl_cli.stages.rows import ObjectSummaryRow
from upvl_cli.types import Array, ParallelArrays, array, concat

DRIVES_KEY = b"upvl.drives"
DriveKey = tuple[str, str]  # name of a drive, digests of its shard and of the basis


@dataclass(frozen=True)
class Objects(ParallelArrays):
    """The stored boxes of one drive, by frame and row, in single precision.

    Attributes:
        frame: (n,) index of the frame.
        box: (n,) row of the box in its frame.
        track_id: (n,) number of the track, -1 for none.
        time_s: (n,) time since the first frame of the drive.
        confidence: (n,) score of the box itself, 0 to 1.
        num_features: (n,) points of the box that have a feature.
        center_m: (n, 3) centre, in ego axes.
        size_lwh_m: (n, 3) length, width and height.
        heading_rad: (n,) direction of the length, in ego axes.
        velocity_mps: (n, 3) velocity over the ground along the ego axes.
        pooled: (n, COMPONENTS) mean feature, rounded.
        num_looks: (n,) pictures of its track that were looked at.
        look_feature: (n, COMPONENTS) mean feature of these looks, rounded.
    """

    frame: Array = array("int64")
    box: Array = array("int32")
    track_id: Array = array("int64")
    time_s: Array = array("float64")
    confidence: Array = array("float32")
    num_features: Array = array("int32")
    center_m: Array = array("float32", 3)
    size_lwh_m: Array = array("float32", 3)
    heading_rad: Array = array("float32")
    velocity_mps: Array = array("float32", 3)
    pooled: Array = array("int8", COMPONENTS)
    num_looks: Array = array("int32")
    look_feature: Array = array("int8", COMPONENTS)

    @property
    def range_m(self) -> Array:
        """(n,) horizontal distance of the centre from the ego origin."""
        return np.asarray(np.hypot(self.center_m[:, 0], self.center_m[:, 1]))

    @property
    def speed_mps(self) -> Array:
        """(n,) horizontal speed over the ground."""
        return np.asarray(np.hypot(self.velocity_mps[:, 0], self.velocity_mps[:, 1]))


def indexed_objects(store: Store) -> Iterator[tuple[str, Objects]]:
    """Yield the name and the boxes of each drive; the index is made or updated first where it is out of date.

    The arrays are views of the file: what is not used is not read.

    Raises:
        NotMade: A shard is damaged, or was made with another basis than the present one.
    """
    digests = in_order(footer_digest, store.paths.values())
    keys: list[DriveKey] = [
        (name, f"{digest} {store.basis_digest}") for name, digest in zip(store.paths, digests, strict=True)
    ]
    batches = _read_index(store.index)
    if list(batches) != keys:
        _write_index(store, keys, batches)
        batches = _read_index(store.index)
    for (name, _), batch in batches.items():
        yield name, Objects(**{spec.name: _view(batch.column(spec.name)) for spec in fields(Objects)})


def _read_index(path: Path) -> dict[DriveKey, pa.RecordBatch]:
    """Return the batch of each drive; none where the file is missing, damaged or has other columns."""
    with suppress(OSError, pa.ArrowException, KeyError, ValueError):
        file = pa.ipc.open_file(pa.memory_map(str(path)))
        if file.schema.remove_metadata().equals(_schema([]).remove_metadata()):
            keys = [(name, digest) for name, digest in json.loads(file.schema.metadata[DRIVES_KEY])]
            return {key: file.get_batch(number) for number, key in enumerate(keys)}
    return {}


def _write_index(store: Store, keys: list[DriveKey], previous: dict[DriveKey, pa.RecordBatch]) -> None:
    schema = _schema(keys)
    with atomic_file(store.index) as file, pa.ipc.new_file(file, schema) as writer:
        for name, digest in keys:
            batch = previous.get((name, digest))
            if batch is None:
                check_basis(store, store.paths[name])
            columns = _columns(_read_objects(store.paths[name])) if batch is None else batch.columns
            writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=schema))


def _read_objects(path: Path) -> Objects:
    frames: list[Objects] = []
    start_ns: int | None = None
    for row in Table(path, ObjectSummaryRow):
        start_ns = row.time_ns if start_ns is None else start_ns
        boxes = len(row.track_id)
        frames.append(
            Objects(
                frame=np.full(boxes, row.frame),
                box=np.arange(boxes),
                track_id=row.track_id,
                time_s=np.full(boxes, (row.time_ns - start_ns) * 1e-9),
                confidence=row.score,
                num_features=row.num_features,
                center_m=row.center_m,
                size_lwh_m=row.size_lwh_m,
                heading_rad=row.heading_rad,
                velocity_mps=row.velocity_mps,
                pooled=row.pooled,
                num_looks=row.num_looks,
                look_feature=row.look_feature,
            )
        )
    return concat(frames, Objects)


def _schema(keys: list[DriveKey]) -> pa.Schema:
    def arrow_type(spec: Any) -> pa.DataType:
        item, shape = pa.from_numpy_dtype(np.dtype(spec.metadata["dtype"])), spec.metadata["shape"]
        return pa.list_(item, shape[0]) if shape else item

    columns = [pa.field(spec.name, arrow_type(spec), nullable=False) for spec in fields(Objects)]
    return pa.schema(columns, {DRIVES_KEY: json.dumps(keys).encode()})


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
