"""The mapping procedure of CLEAR-MOT, at every score cut-off at once.

Source: waymo-open-dataset 99a4cb3, metrics/mot.cc. Tracks that share no overlap never touch each other, so
each knot of linked tracks is followed on its own. A cut-off only removes boxes, and neighbouring cut-offs
mostly tell the same story: those that do are carried together, as a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from upvl_cli.metrics.assignment import heaviest, ranked_first
from upvl_cli.metrics.official import Matcher

Owners = dict[int, int]  # prediction's track by label's track: the official M


class Link(NamedTuple):
    """An overlap of two tracks in one frame that reaches the threshold at some cut-offs."""

    frame: int
    truth: int
    prediction: int
    since: int
    until: int
    weight: int
    score: float
    edge: int


@dataclass(frozen=True)
class Run:
    """Cut-offs `since` to `until` - 1, which have seen the same so far."""

    since: int
    until: int
    owners: Owners


@dataclass(frozen=True)
class Event:
    """Matches (as numbers of overlaps) and mismatches of one frame at cut-offs `since` to `until` - 1."""

    since: int
    until: int
    matched: list[int]
    mismatches: int


def follow(
    frames: Sequence[list[Link]], present: set[tuple[int, int]], cutoffs: int, matcher: Matcher
) -> Iterator[Event]:
    """Yield what happens to one knot of tracks, frame by frame.

    Args:
        frames: The links of each frame that has any, in order of time.
        present: (label's track, frame) of all labels, linked or not.
        cutoffs: Number of cut-offs.
        matcher: Official rule for pairs that were not matched before.
    """
    runs = [Run(0, cutoffs, {})]
    for links in frames:
        runs_now: list[Run] = []
        borders = sorted({border for link in links for border in (link.since, link.until)})
        for run in runs:
            points = [run.since, *(b for b in borders if run.since < b < run.until), run.until]
            for since, until in pairwise(points):
                active = [link for link in links if link.since <= since < link.until]
                owners = run.owners
                if active:
                    owners, event = _step(owners, active, present, since, until, matcher)
                    yield event
                if runs_now and runs_now[-1].owners == owners:
                    since = runs_now.pop().since
                runs_now.append(Run(since, until, owners))
        runs = runs_now


def _step(
    owners: Owners, links: list[Link], present: set[tuple[int, int]], since: int, until: int, matcher: Matcher
) -> tuple[Owners, Event]:
    """Return M after one frame, and what happened: carry over, match the rest, count mismatches."""
    carried = [link for link in links if owners.get(link.truth) == link.prediction]
    truths, predictions = {link.truth for link in carried}, {link.prediction for link in carried}
    rest = [link for link in links if link.truth not in truths and link.prediction not in predictions]
    if not rest:  # nearly always
        return owners, Event(since, until, [link.edge for link in carried], 0)
    fresh = _matched(rest, matcher)
    now = {link.truth for link in fresh}
    before = {prediction: truth for truth, prediction in owners.items()}
    after, mismatches = dict(owners), 0
    for link in fresh:
        mismatches += link.truth in owners  # a carried pair is not fresh, so it was another prediction
        loser = before.get(link.prediction)
        if loser is not None and loser not in now:
            # A label that is there but unmatched is a miss, and not counted twice.
            mismatches += (loser, link.frame) not in present
            del after[loser]
    after.update((link.truth, link.prediction) for link in fresh)
    return after, Event(since, until, [link.edge for link in carried + fresh], mismatches)


def _matched(links: list[Link], matcher: Matcher) -> list[Link]:
    pairs = [(link.prediction, link.truth, link.weight) for link in links]
    if matcher == "score_first":
        return [links[i] for i in ranked_first(pairs, [link.score for link in links])]
    return [links[i] for i in heaviest(pairs)[0]]
