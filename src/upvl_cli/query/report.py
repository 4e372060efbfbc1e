"""What a query found: as a table for the terminal, and as a file."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.table import Table

from upvl_cli.query.find import Found, Hits
from upvl_cli.query.question import Question
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.types import Ints

LONGEST = 60  # letters of a file name
TOLD = ("boxes", "hits")  # counts that the summary tells in words of its own


def slug(text: str) -> str:
    """A file name for a text: lower case letters, digits and dashes; two texts have two names."""
    name = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:LONGEST].strip("-")
    if name.replace("-", " ") == text:
        return name
    return "-".join([*([name] if name else []), hashlib.sha256(text.encode()).hexdigest()[:8]])


def best_of_tracks(hits: Hits) -> tuple[Ints, Ints]:
    """Places of the best box of each track, and how many boxes it has; a box without a track stands alone.

    Args:
        hits: Best first; a track that is of two classes counts as two.
    """
    number = np.where(hits.track_id < 0, -1 - np.arange(len(hits)), hits.track_id)
    _, segment = np.unique(hits.segment, return_inverse=True)
    keys = np.stack([segment.reshape(-1), number, hits.kind], axis=1)
    _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    order = np.argsort(first)
    return first[order], count[order]


def table(hits: Hits, question: Question, top: int) -> Table:
    """The best box of each of the best tracks, a line each."""
    shown = Table(box=None, pad_edge=False)
    several = len(question.names) < question.asked.sum()  # words a class: else the class is the word
    for heading in ("class", "word")[not several :]:
        shown.add_column(heading)
    for heading in ("score", "votes"):
        shown.add_column(heading, justify="right")
    shown.add_column("drive")
    for heading in ("track", "frames", "best", "time s", "range m", "speed m/s"):
        shown.add_column(heading, justify="right")
    first, frames = best_of_tracks(hits)
    for place, count in zip(first[:top].tolist(), frames.tolist(), strict=False):
        shown.add_row(*_line(hits, question, place, count)[not several :])
    return shown


def _line(hits: Hits, question: Question, place: int, frames: int) -> Sequence[str]:
    track = int(hits.track_id[place])
    return (
        question.names[hits.kind[place]],
        question.words[hits.word[place]],
        f"{hits.score[place]:.2f}",
        f"{hits.share[place]:.0%}",
        str(hits.segment[place]),
        str(track) if track >= 0 else "-",
        str(frames),
        str(hits.frame[place]),
        f"{hits.time_s[place]:.1f}",
        f"{np.hypot(*hits.seven[place, :2]):.1f}",
        f"{np.hypot(*hits.velocity_mps[place, :2]):.1f}",
    )


def summary(found: Found, on: str) -> str:
    """How many boxes there were, and what became of them."""
    objects = len(best_of_tracks(found.hits)[0])
    rest = [f"{items} {reason}" for reason, items in found.counts.items() if items and reason not in TOLD]
    hits = f"{len(found.hits)} hits of {objects} objects"
    return f"{found.counts['boxes']} {on}: {', '.join([hits, *rest])}"


def notes(question: Question, model: str) -> Iterator[str]:
    """What the model cannot tell apart, a line each."""
    for kind, other in question.blurred:
        told = f'{model} does not tell "{kind}" from "{other}": a hit may be any {other}'
        yield f"{told} (a stronger model can be named in vlm.toml)"


def write(path: Path, hits: Hits, question: Question) -> Path:
    """Write all hits, best first, as Parquet; returns the path."""
    columns = {}
    for spec in fields(Hits):
        values = getattr(hits, spec.name)
        columns[spec.name] = pa.array(list(values)) if values.ndim > 1 else pa.array(values)
    for name, texts in (("kind", question.names), ("word", question.words)):
        columns[name] = pa.array([texts[number] for number in columns[name].to_pylist()], pa.string())
    with atomic_file(path) as file:
        pq.write_table(pa.table(columns), file, compression="zstd")
    return path
