"""The search index: what filters and rankings need of every stored box, in memory-mapped files.

Each group of drives has an uncompressed Arrow file with one batch a drive, in `out/query/index`. The batch of a drive
whose shard and basis have not changed is copied from the index before; the features of single points are never read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from upvl_cli.perception.visual.open_vocabulary import COMPONENTS
from upvl_cli.pipeline.tables import Table, footer_digest
from upvl_cli.query.groups import groups_of
from upvl_cli.query.mapped_file import MappedFile
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


@dataclass(frozen=True)
class ObjectIndex:
    """The stored boxes of all drives.

    Attributes:
        drives: The boxes of each drive, in the order of the store; views of files: what is not used is not read.
        digests: What the boxes of each drive were read from: the digests of its shard and of the basis.
        files: The file of each drive whose boxes are views of one.
    """

    drives: Mapping[str, Objects]
    digests: Mapping[str, str]
    files: Mapping[str, MappedFile]

    def release_features(self, name: str) -> None:
        """Give back the memory of the features of a drive, two thirds of its bytes; they are read again when used."""
        if name in self.files:
            self.files[name].release(self.drives[name].pooled)
            self.files[name].release(self.drives[name].look_feature)


@dataclass(frozen=True)
class _Group:
    """Boxes of a group of drives, and the file of which they are views, if any."""

    batches: Mapping[DriveKey, pa.RecordBatch]
    file: MappedFile | None = None


def indexed_objects(store: Store) -> Iterator[tuple[str, Objects]]:
    """Yield the name and the boxes of each drive; errors as of `open_index`."""
    yield from open_index(store).drives.items()


def open_index(store: Store) -> ObjectIndex:
    """Return the boxes of all drives; the index is made or updated first where it is out of date.

    Raises:
        NotMade: A shard is damaged, or was made with another basis than the present one.
    """
    digests = in_order(footer_digest, store.paths.values())
    keys = {name: f"{digest} {store.basis_digest}" for name, digest in zip(store.paths, digests, strict=True)}
    groups = {
        store.index / f"{store.source}-{group}.arrow": [(name, keys[name]) for name in names]
        for group, names in groups_of(keys).items()
    }
    found = {path: _read_group(path) for path in groups}
    if any(list(found[path].batches) != expected for path, expected in groups.items()):
        found |= _update(store, groups, found)
    batches = {name: batch for group in found.values() for (name, _), batch in group.batches.items()}
    files = {name: group.file for group in found.values() if group.file for name, _ in group.batches}
    drives = {
        name: Objects(**{spec.name: _view(batches[name].column(spec.name)) for spec in fields(Objects)})
        for name in store.paths
    }
    return ObjectIndex(drives, keys, files)


def _update(
    store: Store,
    groups: Mapping[Path, Sequence[DriveKey]],
    found: Mapping[Path, _Group],
) -> dict[Path, _Group]:
    """Write the groups that are out of date, and return them; files of groups that there are no more are removed."""
    present = sorted(store.index.glob(f"{store.source}-*.arrow")) if store.index.is_dir() else []
    gone = [path for path in present if path not in groups]
    previous = {
        key: batch
        for group in (*found.values(), *map(_read_group, gone))
        for key, batch in group.batches.items()
    }
    updated = {}
    for path, keys in groups.items():
        if list(found[path].batches) != keys:
            batches = {key: previous[key] if key in previous else _batch_of(store, key[0]) for key in keys}
            _write_group(path, batches)
            mapped = _read_group(path)
            # Another process may have written the group of other shards meanwhile.
            updated[path] = mapped if list(mapped.batches) == keys else _Group(batches)
    # The last one is where the boxes of all drives were before there were groups.
    for path in (*gone, store.index.with_name(f"index-{store.source}.arrow")):
        with suppress(OSError):
            path.unlink()
    return updated


def _read_group(path: Path) -> _Group:
    """Return the batch of each drive; none where the file is missing, damaged or has other columns."""
    with suppress(OSError, pa.ArrowException, KeyError, ValueError, TypeError):
        mapped = MappedFile(path)
        file = pa.ipc.open_file(pa.py_buffer(mapped.buffer))
        if file.schema.remove_metadata().equals(_schema([]).remove_metadata()):
            keys = [(name, digest) for name, digest in json.loads(file.schema.metadata[DRIVES_KEY])]
            return _Group({key: file.get_batch(number) for number, key in enumerate(keys)}, mapped)
    return _Group({})


def _write_group(path: Path, batches: Mapping[DriveKey, pa.RecordBatch]) -> None:
    schema = _schema(list(batches))
    with atomic_file(path) as file, pa.ipc.new_file(file, schema) as writer:
        for batch in batches.values():
            writer.write_batch(pa.RecordBatch.from_arrays(batch.columns, schema=schema))


def _batch_of(store: Store, name: str) -> pa.RecordBatch:
    check_basis(store, store.paths[name])
    return pa.RecordBatch.from_arrays(_columns(_read_objects(store.paths[name])), schema=_schema([]))


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
