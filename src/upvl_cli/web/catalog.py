"""What can be searched now: the boxes of all drives of one source, kept open until a shard is made again."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from upvl_cli.errors import BadSetting, NotMade, UpvlError, one_line
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.tables import Table, footer_digest
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.find import WarmStore
from upvl_cli.query.index import ObjectIndex, Objects, open_index
from upvl_cli.query.ranking import Ranking
from upvl_cli.query.store import STAGE_OF, Store, open_store
from upvl_cli.query.vector_search import Vectors, open_vectors
from upvl_cli.runtime.bounded_cache import BoundedCache
from upvl_cli.stages.rows import LabelRow, PointFeatureRow
from upvl_cli.types import Array, concat

_LOOK_AGAIN_S = 1.0  # between two looks at whether shards have changed
_OPEN_TABLES = 64
_HELD_BYTES = 2**28  # of the features of points, all tables together
_RANKING_BYTES = 2**28  # of cosines of negatives: 8 bytes a box for each set of them
_GROUP_BYTES = 2**22  # a row group in memory
HOW_TO_LABEL = "upvl autolabel"
_NO_FEATURES = "no box has a feature, because no picture was used; run: upvl autolabel --all-motion"


@dataclass(frozen=True)
class BoxNames:
    """Class and word of each box of a drive, as the labels have them."""

    class_name: Array
    word: Array


class Catalog:
    """The boxes of one source at one time.

    Attributes:
        source: "labels" or "detections".
        drives: The boxes of each drive.
        store: What words are compared with; None where the boxes have no features.
        no_words: Why no words can be asked; "" where they can.
        digest: Another one for other shards.
    """

    def __init__(
        self,
        workspace: Workspace,
        source: str,
        store: Store | None,
        drives: Mapping[str, Objects],
        digest: str,
        vectors: Vectors | None = None,
    ) -> None:
        """Keep what was opened."""
        self.source, self.store, self.drives, self.digest = source, store, drives, digest
        self.no_words = ""
        self._vectors = vectors or Vectors()
        self._workspace = workspace
        held = max(1, _HELD_BYTES // (_GROUP_BYTES * max(1, min(len(drives), _OPEN_TABLES))))
        self._tables: BoundedCache[Table[PointFeatureRow]] = BoundedCache(_OPEN_TABLES)
        self._held_groups = held
        self._names: BoundedCache[BoxNames] = BoundedCache(256)

    @property
    def warm(self) -> WarmStore:
        """The open boxes, as a search takes them."""
        if self.store is None:
            raise NotMade(self.no_words)
        return WarmStore(self.drives, self.point_features, self._ranking, self._vectors)

    @cached_property
    def _ranking(self) -> Ranking:
        if self.store is None:
            raise NotMade(self.no_words)
        return Ranking(self.store.basis, _RANKING_BYTES)

    @cached_property
    def total(self) -> int:
        """How many boxes there are."""
        return sum(len(objects) for objects in self.drives.values())

    @cached_property
    def has_classes(self) -> bool:
        """Whether the boxes have classes of their own."""
        return self.source == "labels" and any(
            self._workspace.shard("labels", name).exists() for name in self.drives
        )

    def objects(self, segment: str) -> Objects:
        """Return the boxes of a drive.

        Raises:
            BadSetting: There is no such drive.
        """
        if segment not in self.drives:
            raise BadSetting(f"there is no drive {segment[:60]!r} among the {self.source}")
        return self.drives[segment]

    def row(self, segment: str, frame: int, box: int) -> int:
        """Return the row of a box among those of its drive.

        Raises:
            BadSetting: There is no such box.
        """
        objects = self.objects(segment)
        low, high = np.searchsorted(objects.frame, [frame, frame + 1])
        place = int(low) + box
        if not low <= place < high:
            raise BadSetting(f"drive {segment} has no box {box} in frame {frame} among the {self.source}")
        return place

    def point_features(self, segment: str) -> Table[PointFeatureRow]:
        """Return the open table of the features of the points of a drive."""
        if self.store is None:
            raise NotMade(self.no_words)
        path = self.store.paths[segment]
        return self._tables.get_or_make(segment, lambda: Table(path, PointFeatureRow, self._held_groups))

    def names(self, segment: str) -> BoxNames:
        """Return the class and the word of each box of a drive; empty texts where there are no labels of it."""
        return self._names.get_or_make(segment, lambda: self._read_names(segment))

    def _read_names(self, segment: str) -> BoxNames:
        import pyarrow.parquet as pq

        objects = self.objects(segment)
        unnamed = np.full(len(objects), "", dtype=object)
        path = self._workspace.shard("labels", segment)
        if self.source != "labels" or not path.exists():
            return BoxNames(unnamed, unnamed)
        table = pq.read_table(path, columns=["frame", "track_id", "class", "word"])
        known = {
            key: (class_name, word)
            for *key_parts, class_name, word in zip(
                *(table.column(name).to_pylist() for name in ("frame", "track_id", "class", "word")),
                strict=True,
            )
            for key in [tuple(key_parts)]
        }
        pairs = [
            known.get(key, ("", ""))
            for key in zip(objects.frame.tolist(), objects.track_id.tolist(), strict=True)
        ]
        names = np.array(pairs, dtype=object).reshape(-1, 2)
        return BoxNames(names[:, 0], names[:, 1])


class Catalogs:
    """The present catalog of each source; opened when it is first asked for, and again when its shards change."""

    def __init__(self, workspace: Workspace) -> None:
        """Name the workspace; nothing is opened yet."""
        self._workspace = workspace
        self._open: dict[str, tuple[float, str, Catalog]] = {}
        self._lock = threading.Lock()

    def sources(self) -> list[str]:
        """Return the sources that have any shards, labels first."""
        found = []
        for source, stages in (("labels", ("pool-features", "labels")), ("detections", ("detect",))):
            if any(any((self._workspace.out / stage).glob("*.parquet")) for stage in stages):
                found.append(source)
        return found

    def get(self, source: str) -> Catalog:
        """Return what can be searched; "" takes detections where there are any.

        Raises:
            NotMade: There is nothing to search yet, or a shard is damaged.
        """
        known = self.sources()
        if not known:
            raise NotMade(f"nothing has been labelled in {self._workspace.out} yet; run: {HOW_TO_LABEL}")
        source = source or known[-1]
        if source not in known:
            raise NotMade(
                f"there are no {source} in {self._workspace.out}; run: upvl train, then: upvl detect"
            )
        with self._lock:
            looked_s, digest, catalog = self._open.get(source, (-np.inf, "", None))
            if time.monotonic() - looked_s < _LOOK_AGAIN_S and catalog is not None:
                return catalog
            present = self._digest(source)
            if catalog is None or present != digest:
                catalog = self._make(source, present)
            self._open[source] = time.monotonic(), present, catalog
            return catalog

    def _digest(self, source: str) -> str:
        """Return a text that changes with the footers of the shards; a footer is read where a file is another one."""
        stages = (STAGE_OF[source], "labels") if source == "labels" else (STAGE_OF[source],)
        paths = [path for stage in stages for path in sorted((self._workspace.out / stage).glob("*.parquet"))]
        paths.append(self._workspace.shard("pca", WHOLE_DATASET))
        return " ".join(f"{path.parent.name}/{path.name}:{self._footer(path)}" for path in paths)

    def _footer(self, path: Path) -> str:
        try:
            found = path.stat()
        except OSError:
            return ""
        key = (path, found.st_ino, found.st_size, found.st_mtime_ns)
        return self._footers.get_or_make(key, lambda: footer_digest(path))

    @cached_property
    def _footers(self) -> BoundedCache[str]:
        return BoundedCache(20_000)

    def _make(self, source: str, digest: str) -> Catalog:
        try:
            store = open_store(self._workspace, source)
            index = _open_index(store)
        except UpvlError as error:
            if source != "labels" or not any((self._workspace.out / "labels").glob("*.parquet")):
                raise
            return self._without_features(one_line(error), digest)
        vectors = open_vectors(store, index.drives, index.digests)
        catalog = Catalog(self._workspace, source, store, index.drives, digest, vectors)
        if not any(
            ((objects.num_features > 0) | (objects.num_looks > 0)).any() for objects in index.drives.values()
        ):
            catalog.no_words = _NO_FEATURES
        else:
            catalog.no_words = self._model_problem()
        return catalog

    def _without_features(self, problem: str, digest: str) -> Catalog:
        paths = sorted((self._workspace.out / "labels").glob("*.parquet"))
        drives = {path.stem: _plain_objects(Table(path, LabelRow)) for path in paths}
        catalog = Catalog(self._workspace, "labels", None, drives, digest)
        catalog.no_words = problem
        return catalog

    def _model_problem(self) -> str:
        try:
            self._workspace.model.embed_text(["car"])
        except (UpvlError, ImportError, OSError) as error:
            return f"the vision-language model cannot be opened: {one_line(error)}"
        return ""


def _open_index(store: Store) -> ObjectIndex:
    """Return the boxes of all drives from the search index, which is kept elsewhere where `out` cannot be written."""
    try:
        return open_index(store)
    except NotMade:
        raise
    except UpvlError:
        return open_index(replace(store, index=Path(tempfile.mkdtemp(prefix="upvl-serve-"))))


def _plain_objects(table: Table[LabelRow]) -> Objects:
    """Return the boxes of labels without features."""
    parts: list[Objects] = []
    start_ns: int | None = None
    for row in table:
        start_ns = row.time_ns if start_ns is None else start_ns
        parts.append(_objects_of(row, (row.time_ns - start_ns) * 1e-9))
    return concat(parts, Objects)


def _objects_of(row: LabelRow, time_s: float) -> Objects:
    boxes = len(row.track_id)
    codes = np.zeros((boxes, 64), np.int8)
    return Objects(
        frame=np.full(boxes, row.frame),
        box=np.arange(boxes),
        track_id=row.track_id,
        time_s=np.full(boxes, time_s),
        confidence=row.score,
        num_features=np.zeros(boxes),
        center_m=row.center_m,
        size_lwh_m=row.size_lwh_m,
        heading_rad=row.heading_rad,
        velocity_mps=row.velocity_mps,
        pooled=codes,
        num_looks=np.zeros(boxes),
        look_feature=codes,
    )
