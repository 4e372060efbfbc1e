"""`upvl index`: the files of vectors of all groups, each made where its drives or their basis have changed."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.groups import groups_of
from upvl_cli.query.index import Objects, open_index
from upvl_cli.query.store import Store, open_store
from upvl_cli.query.vector_files import DIM, is_whole, read_stamp, stamp_path, write_vectors
from upvl_cli.runtime.parallel import threads
from upvl_cli.types import Array, Floats, Ints

if TYPE_CHECKING:
    import faiss

# A list is read whole, and its centre stands for it: few vectors a list make the centre a good guide, many make few
# centres to compare. The time to train grows with the square of the number of lists.
_VECTORS_PER_LIST = 400
_MAX_LISTS = 2048
_SAMPLES_PER_LIST = 40
_ITERATIONS = 6
_ROWS = 2**16  # vectors in memory at once, as floats: 17 MB


def make_index(workspace: Workspace, source: str | None) -> Iterator[str]:
    """Make the files of vectors that are missing or out of date; yield one line for each, and a summary.

    Raises:
        BadSetting: faiss is not installed, or the source is unknown.
        NotMade: There is nothing to search yet.
    """
    if find_spec("faiss") is None:
        raise BadSetting("upvl index needs the package faiss; run: pip install 'upvl[index]'")
    store = open_store(workspace, source)
    found = open_index(store)
    groups = groups_of(found.drives)
    total = made = 0
    for group, names in groups.items():
        path = store.index / f"{store.source}-{group}.faiss"
        drives = tuple((name, found.digests[name], len(found.drives[name])) for name in names)
        stamp = read_stamp(path)
        if stamp is None or stamp.drives != drives or not is_whole(path, stamp):
            started_s = time.monotonic()
            index = build_vectors([found.drives[name] for name in names], store.basis)
            stamp = write_vectors(path, index, drives)
            made += 1
            boxes = sum(boxes for _, _, boxes in drives)
            yield (
                f"made {path}: {boxes} boxes of {len(drives)} drive{'s' * (len(drives) != 1)}, "
                f"{stamp.vectors} vectors, {time.monotonic() - started_s:.1f} s"
            )
        total += stamp.size
    _remove_others(store, groups)
    boxes = sum(map(len, found.drives.values()))
    yield (
        f"{boxes} {store.source} of {len(found.drives)} drives: {made} groups made, {len(groups) - made} were fresh; "
        f"{total / 1e6:.0f} MB"
    )


def _remove_others(store: Store, groups: dict[str, tuple[str, ...]]) -> None:
    """Remove the files of groups that there are no more: their drives are in others now, or gone."""
    kept = {f"{store.source}-{group}" for group in groups}
    for path in store.index.glob(f"{store.source}-*.faiss"):
        if path.stem not in kept:
            for unused in (path, stamp_path(path)):
                with suppress(OSError):
                    unused.unlink()


def build_vectors(drives: Sequence[Objects], basis: Basis) -> faiss.IndexIVFScalarQuantizer:
    """Return the inverted index of the boxes of a group of drives, complete in memory.

    Args:
        drives: The boxes of each drive.
        basis: Basis of their features.
    """
    import faiss

    codes, numbers = _codes(drives)
    before = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(threads())
    try:
        coarse = _trained(codes, basis)
        lists = coarse.ntotal
        list_of = np.empty(len(codes), np.int64)
        total = np.zeros((lists, DIM))
        lowest, highest = np.full(DIM, np.inf, np.float32), np.full(DIM, -np.inf, np.float32)
        for begin in range(0, len(codes), _ROWS):
            vectors = _vectors(codes[begin : begin + _ROWS], basis)
            nearest = coarse.search(vectors, 1)[1][:, 0]
            list_of[begin : begin + _ROWS] = nearest
            order = np.argsort(nearest, kind="stable")
            present, first = np.unique(nearest[order], return_index=True)
            total[present] += np.add.reduceat(vectors[order], first, axis=0)
            lowest, highest = (
                np.minimum(lowest, vectors.min(axis=0)),
                np.maximum(highest, vectors.max(axis=0)),
            )
        center = (total / np.maximum(np.bincount(list_of, minlength=lists), 1)[:, None]).astype(np.float32)
        return _filled(codes, numbers, basis, list_of, center, np.stack([lowest, highest]))
    finally:
        faiss.omp_set_num_threads(before)


def _codes(drives: Sequence[Objects]) -> tuple[Array, Ints]:
    """Return (n, COMPONENTS) int8 features to store, and (n,) their numbers."""
    codes: list[Array] = [np.zeros((0, DIM - 1), np.int8)]
    numbers: list[Ints] = [np.zeros(0, np.int64)]
    first_row = 0
    for objects in drives:
        rows = np.flatnonzero(objects.num_features > 0)
        codes.append(objects.pooled[rows])
        numbers.append(2 * (first_row + rows))
        looks = _first_of_looks(objects)
        codes.append(objects.look_feature[looks])
        numbers.append(2 * (first_row + looks) + 1)
        first_row += len(objects)
    return np.concatenate(codes), np.concatenate(numbers)


def _first_of_looks(objects: Objects) -> Ints:
    """Return one row of each track that was looked at: its boxes share the looks. A box without a track has its own."""
    rows = np.flatnonzero(objects.num_looks > 0)
    key = np.where(objects.track_id[rows] < 0, -1 - rows, objects.track_id[rows])
    _, first, track = np.unique(key, return_index=True, return_inverse=True)
    first = rows[first]
    looks = objects.look_feature
    differs = (looks[rows] != looks[first[track.reshape(-1)]]).any(axis=1)
    return np.union1d(first, rows[differs])


def _vectors(codes: Array, basis: Basis) -> Floats:
    return np.ascontiguousarray(basis.compact(basis.dequantize(codes)), np.float32)


def _trained(codes: Array, basis: Basis) -> Any:
    """Return an index of the directions of the lists, by k-means on a sample."""
    import faiss

    lists = int(np.clip(len(codes) // _VECTORS_PER_LIST, 1, _MAX_LISTS))
    coarse = faiss.IndexFlatIP(DIM)
    sample = np.sort(
        np.random.default_rng(0).choice(len(codes), min(len(codes), lists * _SAMPLES_PER_LIST), replace=False)
    )
    if lists == 1:
        coarse.add(np.ones((1, DIM), np.float32))
        return coarse
    kmeans = faiss.Kmeans(
        DIM, lists, niter=_ITERATIONS, seed=1, spherical=True, max_points_per_centroid=_SAMPLES_PER_LIST
    )
    kmeans.train(_vectors(codes[sample], basis))
    coarse.add(np.asarray(kmeans.centroids, np.float32))
    return coarse


def _filled(
    codes: Array, numbers: Ints, basis: Basis, list_of: Ints, center: Floats, bounds: Floats
) -> faiss.IndexIVFScalarQuantizer:
    """Return the index with the vectors in their lists.

    Args:
        codes: (n, COMPONENTS) features.
        numbers: (n,) their numbers.
        basis: Their basis.
        list_of: (n,) list of each.
        center: (lists, DIM) mean vector of each list.
        bounds: (2, DIM) lowest and highest value of each component, between which the eight bits lie.
    """
    import faiss

    flat = faiss.IndexFlatIP(DIM)
    flat.add(center)
    kind = faiss.ScalarQuantizer.QT_8bit
    index = faiss.IndexIVFScalarQuantizer(flat, DIM, len(center), kind, faiss.METRIC_INNER_PRODUCT, False)
    index.train(bounds if len(codes) else np.zeros((2, DIM), np.float32))
    for begin in range(0, len(codes), _ROWS):
        vectors = _vectors(codes[begin : begin + _ROWS], basis)
        number = np.ascontiguousarray(numbers[begin : begin + _ROWS])
        lists = np.ascontiguousarray(list_of[begin : begin + _ROWS])
        index.add_core(len(vectors), faiss.swig_ptr(vectors), faiss.swig_ptr(number), faiss.swig_ptr(lists))
    return index
