"""Geometry of histograms as SVG: numbers in, places of bars and ticks out; the template draws them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.drawing.colours import CLASSES
from upvl_cli.types import Array

WIDTH, HEIGHT = 360.0, 200.0  # of the drawing; a phone shows it at about this size
LEFT, RIGHT, TOP, BOTTOM = 40.0, 8.0, 10.0, 34.0  # margins
MOST_BINS = 24
ROW_HEIGHT, NAME_WIDTH, COUNT_WIDTH = 22.0, 118.0, 52.0  # of a ranking
LONGEST_NAME = 16  # characters of a name that fit into NAME_WIDTH
MOST_ROWS = 14


@dataclass(frozen=True)
class Bar:
    """One bar: its rectangle, the class that gives it its colour, and the text of its tooltip."""

    x: float
    y: float
    width: float
    height: float
    kind: str
    title: str


@dataclass(frozen=True)
class Tick:
    """A mark of an axis: its place along the axis, and its text."""

    place: float
    text: str


@dataclass(frozen=True)
class Histogram:
    """How often each value occurs, stacked by class.

    Attributes:
        title: What is counted.
        unit: Quantity and unit of the horizontal axis.
        bars: The bars.
        x_ticks: Marks of the horizontal axis.
        y_ticks: Marks of the vertical axis.
        summary: The figures in words, for those who do not see the picture.
    """

    title: str
    unit: str
    bars: tuple[Bar, ...]
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    summary: str


@dataclass(frozen=True)
class RankingRow:
    """One name of a ranking: its text, in full and as it fits, how often it occurs, and its bars."""

    name: str
    short: str
    count: int
    y: float
    bars: tuple[Bar, ...]


@dataclass(frozen=True)
class Ranking:
    """The names that occur most, as horizontal bars.

    Attributes:
        title: What is counted.
        rows: The most frequent names, first the most frequent.
        height: Height of the drawing.
        others: How many names are left out.
        summary: The figures in words.
    """

    title: str
    rows: tuple[RankingRow, ...]
    height: float
    others: int
    summary: str


def kind_of(class_name: str) -> str:
    """Return the name of a class that has a colour; classes that are not known look like "other"."""
    return class_name if class_name in CLASSES else "other"


def round_step(span: float, most: int) -> float:
    """Return a step of 1, 2 or 5 times a power of ten, of which at most `most` make up the span."""
    if not span > 0:
        return 1.0
    smallest = span / most
    power = 10.0 ** np.floor(np.log10(smallest))
    return float(next(power * factor for factor in (1, 2, 5, 10) if power * factor >= smallest * (1 - 1e-9)))


def histogram(title: str, unit: str, values: Array, kinds: Sequence[str] | Array) -> Histogram | None:
    """Return a histogram from 0 up, or None without a finite value.

    Args:
        title: What is counted.
        unit: Quantity and unit of the values, for the axis.
        values: (n,) values of 0 or more; those that are not finite are left out.
        kinds: (n,) class of each.
    """
    finite = np.isfinite(values)
    values, kinds = np.asarray(values)[finite], [kind_of(str(kind)) for kind in np.asarray(kinds)[finite]]
    if not len(values):
        return None
    step = round_step(float(values.max()), MOST_BINS)
    bins = int(np.floor(values.max() / step + 1e-9)) + 1
    place = np.clip(np.floor(values / step + 1e-9).astype(int), 0, bins - 1)
    present = [kind for kind in CLASSES if kind in set(kinds)]
    counts = np.array(
        [np.bincount(place[np.array(kinds) == kind], minlength=bins) for kind in present]
    )  # (k, bins)
    most = int(counts.sum(axis=0).max())
    x_scale, y_scale = (WIDTH - LEFT - RIGHT) / bins, (HEIGHT - TOP - BOTTOM) / most
    base = HEIGHT - BOTTOM
    bars = []
    for column in range(bins):
        height = 0.0
        for kind, count in zip(present, counts[:, column].tolist(), strict=True):
            if count:
                span = f"{column * step:g} to {(column + 1) * step:g}"
                rise = count * y_scale
                x, y = LEFT + column * x_scale, base - height - rise
                bars.append(Bar(x, y, max(x_scale - 1, 1), rise, kind, f"{span}: {count} {kind}"))
                height += rise
    low, middle, high = np.percentile(values, [5, 50, 95])
    summary = f"{len(values)} values, median {middle:.3g}, 5 % below {low:.3g} and 5 % above {high:.3g}"
    return Histogram(
        title,
        unit,
        tuple(bars),
        tuple(_x_ticks(bins, step, x_scale)),
        tuple(_y_ticks(most, y_scale, base)),
        summary,
    )


def _x_ticks(bins: int, step: float, x_scale: float) -> list[Tick]:
    each = int(max(1, round_step(bins, 7)))
    return [Tick(LEFT + edge * x_scale, f"{edge * step:g}") for edge in range(0, bins + 1, each)]


def _y_ticks(most: int, y_scale: float, base: float) -> list[Tick]:
    each = max(1.0, round_step(most, 4))
    marks = np.arange(0, most + each / 2, each)
    return [Tick(base - mark * y_scale, f"{mark:g}") for mark in marks[marks <= most].tolist()]


def ranking(title: str, names: Sequence[str], kinds: Sequence[str]) -> Ranking | None:
    """Return how often each name occurs, or None without a name.

    Args:
        title: What is counted.
        names: (n,) names.
        kinds: (n,) class of each.
    """
    totals = Counter(names)
    if not totals:
        return None
    by_kind = Counter(zip(names, map(kind_of, kinds), strict=True))
    chosen = sorted(totals.items(), key=lambda item: (-item[1], item[0]))[:MOST_ROWS]
    scale = (WIDTH - NAME_WIDTH - COUNT_WIDTH) / chosen[0][1]
    rows = []
    for number, (name, count) in enumerate(chosen):
        x, y, bars = NAME_WIDTH, number * ROW_HEIGHT, []
        for kind in CLASSES:
            if items := by_kind[name, kind]:
                bars.append(Bar(x, y + 3, items * scale, ROW_HEIGHT - 7, kind, f"{name}: {items} {kind}"))
                x += items * scale
        short = name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"
        rows.append(RankingRow(name, short, count, y, tuple(bars)))
    summary = ", ".join(f"{row.name} {row.count}" for row in rows)
    return Ranking(title, tuple(rows), len(rows) * ROW_HEIGHT, len(totals) - len(rows), summary)
