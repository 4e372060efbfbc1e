"""What is in a fleet, without being asked for: clusters of tracks, their nearest words, and what fits no word.

A cluster fits no word where a word for something that no street has (violin, glacier) is as near to it as the nearest
word of the street: its nearest word is then no nearer than chance.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.table import Table

from upvl_cli.errors import BadInput
from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.clusters import cluster, neighbor_distances
from upvl_cli.query.config import QueryConfig, SuggestConfig
from upvl_cli.query.fleet import FleetTracks, fleet_tracks
from upvl_cli.query.run import check_segments, query_config
from upvl_cli.query.store import HOW_TO_MAKE, open_store
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.runtime.package_files import package_bytes
from upvl_cli.stages import classify, mask
from upvl_cli.types import Bools, Floats, Ints, Model

STREET, UNRELATED = "street_words.txt", "unrelated_words.txt"  # lists of words beside this file, a line each


@dataclass(frozen=True)
class FleetWords:
    """Words that clusters are named by, as vectors for `Basis.compact`.

    Attributes:
        street: The t words of the street, general ones before special ones.
        street_vectors: (t, d) theirs.
        unrelated: The u words for things that no street has.
        unrelated_vectors: (u, d) theirs.
    """

    street: tuple[str, ...]
    street_vectors: Floats
    unrelated: tuple[str, ...]
    unrelated_vectors: Floats


@dataclass(frozen=True)
class Suggestions:
    """The clusters of a fleet, the largest first.

    Attributes:
        cluster_of_track: (n,) number of the cluster of each track.
        example: (c,) the track that is nearest to the mean of each cluster.
        word: (c, w) numbers of the nearest words of the street, nearest first.
        cosine: (c, w) their cosines with the mean of the cluster.
        unrelated: (c,) number of the nearest word for something that no street has.
        unrelated_cosine: (c,) its cosine.
    """

    cluster_of_track: Ints
    example: Ints
    word: Ints
    cosine: Floats
    unrelated: Ints
    unrelated_cosine: Floats

    @property
    def fits_word(self) -> Bools:
        """(c,) whether the nearest word of the street is nearer than any unrelated one."""
        return np.asarray(self.cosine.max(axis=1, initial=-1) > self.unrelated_cosine)


def suggest_words(
    workspace: Workspace, source: str | None, segments: Collection[str], clusters: int | None
) -> Iterator[Table | str]:
    """List what is in a fleet; yield what is printed, and write the clusters and their tracks as Parquet.

    Args:
        workspace: Holds the stored boxes, the model and the settings.
        source: "labels" or "detections"; None takes detections where there are any.
        segments: Names of the drives; an empty collection takes all.
        clusters: Number of clusters; None takes as many as the spread of the tracks gives.

    Raises:
        BadInput: No stored box has a feature.
        BadSetting: A drive is unknown.
        NotMade: There is nothing to cluster yet.
    """
    config = query_config(workspace, {})
    store = open_store(workspace, source)
    check_segments(workspace, store, segments)
    tracks = fleet_tracks(store, segments)
    if not len(tracks):
        raise BadInput(f"none of the {store.source} has a feature; run: {HOW_TO_MAKE[store.source]}")
    words = fleet_words(workspace, store.basis)
    found = suggest(tracks, words, config.suggest, clusters)
    yield _table(tracks, words, found, config)
    yield _summary(tracks, found, store.source, config)
    folder = workspace.out / "query"
    yield str(_write_clusters(folder / "suggest.parquet", tracks, words, found, config))
    yield str(_write_tracks(folder / "suggest-tracks.parquet", tracks, found))


def fleet_words(workspace: Workspace, basis: Basis) -> FleetWords:
    """Return the words of `classify.toml` and `mask.toml` and of both lists; words without a vector are left out."""
    names = workspace.settings(classify.STAGE)
    given = [
        word
        for spec in fields(names)
        if isinstance(getattr(names, spec.name), tuple)
        for word in getattr(names, spec.name)
    ]
    street, street_vectors = _embed(
        workspace.model, [*given, *workspace.settings(mask.STAGE).background, *_lines(STREET)], basis
    )
    unrelated, unrelated_vectors = _embed(workspace.model, _lines(UNRELATED), basis)
    return FleetWords(street, street_vectors, unrelated, unrelated_vectors)


def _lines(name: str) -> list[str]:
    return package_bytes("upvl_cli.query", name).decode("utf-8").splitlines()


def _embed(model: Model, words: list[str], basis: Basis) -> tuple[tuple[str, ...], Floats]:
    once = list(dict.fromkeys(words))
    vectors = model.embed_text(once)
    known = np.asarray(vectors.any(axis=1))
    kept = tuple(word for word, is_known in zip(once, known, strict=True) if is_known)
    return kept, basis.compact_words(vectors[known])


def suggest(
    tracks: FleetTracks, words: FleetWords, config: SuggestConfig, clusters: int | None
) -> Suggestions:
    """Cluster the tracks, and name each cluster by its nearest words.

    Args:
        tracks: At least one.
        words: The words.
        config: When clusters are merged, and how many words they have.
        clusters: Number of clusters; None merges what differs no more than the views of one object.
    """
    number = cluster(
        tracks.vector, max_distance(tracks, config), max_groups=config.max_groups, clusters=clusters
    )
    order = np.argsort(number, kind="stable")
    _, first = np.unique(number[order], return_index=True)
    centre = np.add.reduceat(tracks.vector[order].astype(np.float64), first, axis=0)
    centre /= np.maximum(np.linalg.norm(centre, axis=1, keepdims=True), 1e-9)
    likeness = np.einsum("nd,nd->n", tracks.vector, centre[number])
    nearest_first = np.lexsort((-likeness, number))
    cosines = centre @ words.street_vectors.T
    word = _nearest_words(cosines, config)
    unrelated = centre @ words.unrelated_vectors.T
    best = unrelated.argmax(axis=1)
    return Suggestions(
        number,
        nearest_first[first],
        word,
        np.take_along_axis(cosines, word, axis=1),
        best,
        unrelated[np.arange(len(best)), best],
    )


def max_distance(tracks: FleetTracks, config: SuggestConfig) -> float:
    """Return the mean cosine distance up to which clusters are merged: twice the larger of two measures of the fleet.

    The views of one object lie so far from their mean, and a kind holds at least those; where the car stands they are
    all alike, and objects differ from their nearest neighbours by more.

    Args:
        tracks: The tracks.
        config: Quantiles of both.
    """
    spread = tracks.spread[~np.isnan(tracks.spread)]
    apart = neighbor_distances(tracks.vector)
    return 2 * max(
        float(np.quantile(spread, config.spread_quantile)) if len(spread) else 0.0,
        float(np.quantile(apart, config.neighbor_quantile)) if len(apart) else 0.0,
    )


def _nearest_words(cosines: Floats, config: SuggestConfig) -> Ints:
    """Return (c, w) numbers of the nearest words; of those that tie with the nearest the first of the list leads."""
    order = np.argsort(-cosines, axis=1, kind="stable")[:, : config.words]
    ties = cosines >= cosines.max(axis=1, keepdims=True) - config.tie_cosine
    found = []
    for lead, row in zip(ties.argmax(axis=1).tolist(), order.tolist(), strict=True):
        found.append([lead, *(word for word in row if word != lead)][: config.words])
    return np.array(found)


@dataclass(frozen=True)
class _Line:
    """What is said of one cluster."""

    tracks: int
    boxes: int
    drives: int
    moving_share: float
    size_lwh_m: Floats
    confidence: float


def _lines_of(tracks: FleetTracks, found: Suggestions, config: QueryConfig) -> Iterator[_Line]:
    order = np.argsort(found.cluster_of_track, kind="stable")
    for rows in np.split(order, np.cumsum(np.bincount(found.cluster_of_track))[:-1]):
        members = tracks[rows]
        yield _Line(
            len(rows),
            int(members.boxes.sum()),
            len(np.unique(members.segment)),
            float((members.speed_mps >= config.moving_mps).mean()),
            np.median(members.size_lwh_m, axis=0),
            float(np.median(members.confidence)),
        )


def _table(tracks: FleetTracks, words: FleetWords, found: Suggestions, config: QueryConfig) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("nearest words")
    for heading in ("tracks", "boxes", "drives", "moving", "size m", "score"):
        table.add_column(heading, justify="right")
    table.add_column("example: drive")
    for heading in ("frame", "track"):
        table.add_column(heading, justify="right")
    for number, line in enumerate(_lines_of(tracks, found, config)):
        if number == config.top:
            break
        example = found.example[number]
        track = int(tracks.track_id[example])
        table.add_row(
            _named(words, found, number),
            *(str(count) for count in (line.tracks, line.boxes, line.drives)),
            f"{line.moving_share:.0%}",
            " x ".join(f"{side:.1f}" for side in line.size_lwh_m),
            f"{line.confidence:.2f}",
            str(tracks.segment[example]),
            str(tracks.frame[example]),
            str(track) if track >= 0 else "-",
        )
    return table


def _named(words: FleetWords, found: Suggestions, number: int) -> str:
    near = zip(found.word[number].tolist(), found.cosine[number].tolist(), strict=True)
    named = ", ".join(f"{words.street[word]} {cosine:.2f}" for word, cosine in near)
    if found.fits_word[number]:
        return named
    unrelated = words.unrelated[found.unrelated[number]]
    return f"no word ({named}; {unrelated} {found.unrelated_cosine[number]:.2f})"


def _summary(tracks: FleetTracks, found: Suggestions, source: str, config: QueryConfig) -> str:
    total = len(found.example)
    without = np.flatnonzero(~found.fits_word)
    shown = f"; the largest {config.top} are shown" if total > config.top else ""
    return (
        f"{int(tracks.boxes.sum())} {source} with features, {len(tracks)} tracks in {total} clusters{shown}; "
        f"{len(without)} clusters with {int(np.isin(found.cluster_of_track, without).sum())} tracks fit no word: "
        "an unrelated word is as near"
    )


def _write_clusters(
    path: Path, tracks: FleetTracks, words: FleetWords, found: Suggestions, config: QueryConfig
) -> Path:
    """Write one row a cluster."""
    lines, example = list(_lines_of(tracks, found, config)), tracks[found.example]
    size_m = np.array([line.size_lwh_m for line in lines])
    columns = {
        "cluster": np.arange(len(lines)),
        "words": pa.array([[words.street[word] for word in row] for row in found.word.tolist()]),
        "cosines": pa.array(found.cosine.tolist()),
        "fits_word": found.fits_word,
        "unrelated_word": pa.array([words.unrelated[word] for word in found.unrelated.tolist()]),
        "unrelated_cosine": found.unrelated_cosine,
        "tracks": np.array([line.tracks for line in lines]),
        "boxes": np.array([line.boxes for line in lines]),
        "drives": np.array([line.drives for line in lines]),
        "moving_share": np.array([line.moving_share for line in lines]),
        **{f"{side}_m": size_m[:, place] for place, side in enumerate(("length", "width", "height"))},
        "confidence": np.array([line.confidence for line in lines]),
        "example_segment": example.segment,
        "example_frame": example.frame,
        "example_track_id": example.track_id,
    }
    return _write(path, columns)


def _write_tracks(path: Path, tracks: FleetTracks, found: Suggestions) -> Path:
    """Write one row a track."""
    columns = {
        "cluster": found.cluster_of_track,
        "segment": tracks.segment,
        "track_id": tracks.track_id,
        "frame": tracks.frame,
        "boxes": tracks.boxes,
        "speed_mps": tracks.speed_mps,
        "confidence": tracks.confidence,
    }
    return _write(path, columns)


def _write(path: Path, columns: Mapping[str, object]) -> Path:
    with atomic_file(path) as file:
        table = pa.table({name: pa.array(values) for name, values in columns.items()})
        pq.write_table(table, file, compression="zstd")
    return path
