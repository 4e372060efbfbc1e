"""The result of a query as a table for the terminal and as a Parquet file."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.table import Table

from upvl_cli.query.find import Hits, QueryResult
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.types import Array, Ints

MAX_SLUG_LETTERS = 60
HEADLINE_COUNTS = ("boxes", "hits")  # the summary states these first


def slug(text: str) -> str:
    """Return a file name for a text: lower case letters, digits and dashes; two texts have two names."""
    name = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:MAX_SLUG_LETTERS].strip("-")
    if name.replace("-", " ") == text:
        return name
    return "-".join([*([name] if name else []), hashlib.sha256(text.encode()).hexdigest()[:8]])


def best_of_tracks(hits: Hits) -> tuple[Ints, Ints]:
    """Return the index of the best box of each track, and how many boxes it has; no track is a track of its own.

    Args:
        hits: Best first; a track that is of two classes counts as two.
    """
    track = np.where(hits.track_id < 0, -1 - np.arange(len(hits)), hits.track_id)
    _, segment = np.unique(hits.segment, return_inverse=True)
    keys = np.stack([segment.reshape(-1), track, hits.class_index], axis=1)
    _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    order = np.argsort(first)
    return first[order], count[order]


def hit_table(hits: Hits, vocabulary: Vocabulary, top: int) -> Table:
    """Return the best box of each of the best `top` tracks, one line each."""
    table = Table(box=None, pad_edge=False)
    # Where each class has one word, the class is the word and needs no column.
    several = len(vocabulary.class_names) < vocabulary.is_queried.sum()
    for heading in ("class", "word")[not several :]:
        table.add_column(heading)
    for heading in ("score", "votes"):
        table.add_column(heading, justify="right")
    table.add_column("drive")
    for heading in ("track", "frames", "best", "time s", "range m", "speed m/s"):
        table.add_column(heading, justify="right")
    best, frames = best_of_tracks(hits)
    for index, count in zip(best[:top].tolist(), frames.tolist(), strict=False):
        table.add_row(*_line(hits, vocabulary, index, count)[not several :])
    return table


def _line(hits: Hits, vocabulary: Vocabulary, index: int, frames: int) -> Sequence[str]:
    track = int(hits.track_id[index])
    return (
        vocabulary.class_names[hits.class_index[index]],
        vocabulary.words[hits.word_index[index]],
        f"{hits.score[index]:.2f}",
        f"{hits.share[index]:.0%}",
        str(hits.segment[index]),
        str(track) if track >= 0 else "-",
        str(frames),
        str(hits.frame[index]),
        f"{hits.time_s[index]:.1f}",
        f"{np.hypot(*hits.center_m[index, :2]):.1f}",
        f"{np.hypot(*hits.velocity_mps[index, :2]):.1f}",
    )


def summary(result: QueryResult, source: str) -> str:
    """Return in one line how many boxes there were, and what became of them."""
    objects = len(best_of_tracks(result.hits)[0])
    others = [
        f"{items} {reason}"
        for reason, items in result.counts.items()
        if items and reason not in HEADLINE_COUNTS
    ]
    hits = f"{len(result.hits)} hits of {objects} objects"
    ranking = f"; {result.ranking}" if result.ranking else ""
    return f"{result.counts['boxes']} {source}: {', '.join([hits, *others])}{ranking}"


def ambiguity_notes(vocabulary: Vocabulary, model: str) -> Iterator[str]:
    """Yield one line for each pair of words that the model cannot distinguish."""
    for word, general in vocabulary.ambiguous:
        note = f'{model} cannot distinguish "{word}" from "{general}": a hit may be any {general}'
        yield f"{note} (a stronger model can be named in vlm.toml)"


def hits_as_table(hits: Hits, vocabulary: Vocabulary) -> pa.Table:
    """Return all hits, best first, as a table with one row a box and one column a number."""
    classes, words = np.array(vocabulary.class_names, dtype=object), np.array(vocabulary.words, dtype=object)
    columns = {
        "segment": hits.segment,
        "frame": hits.frame,
        "box": hits.box,
        "track_id": hits.track_id,
        "time_s": hits.time_s,
        "class": pa.array(classes[hits.class_index], pa.string()),
        "word": pa.array(words[hits.word_index], pa.string()),
        "score": hits.score,
        "share": hits.share,
        "cosine": hits.cosine,
        "confidence": hits.confidence,
        "num_features": hits.num_features,
        **_split("center_{}_m", "xyz", hits.center_m),
        **_split("{}_m", ("length", "width", "height"), hits.size_lwh_m),
        "heading_rad": hits.heading_rad,
        **_split("velocity_{}_mps", "xyz", hits.velocity_mps),
    }
    return pa.table({name: pa.array(values) for name, values in columns.items()})


def write_hits(path: Path, hits: Hits, vocabulary: Vocabulary) -> Path:
    """Write all hits as Parquet, as `hits_as_table` gives them; return the path."""
    with atomic_file(path) as file:
        pq.write_table(hits_as_table(hits, vocabulary), file, compression="zstd")
    return path


def _split(pattern: str, parts: Sequence[str], values: Array) -> dict[str, Array]:
    return {pattern.format(part): values[:, number] for number, part in enumerate(parts)}
