"""The mapping procedure of CLEAR-MOT at every score cut-off at once (Bernardin and Stiefelhagen, 2008).

Source: waymo-open-dataset 99a4cb3, metrics/mot.cc. Tracks that share no overlap never touch each other, so
each connected component of tracks is followed on its own. A cut-off only removes boxes, and neighbouring cut-offs
mostly have the same history: those that do are followed together, as a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from upvl_cli.metrics.waymo.assignment import heaviest_matching, match_by_score
from upvl_cli.metrics.waymo.official import Matcher

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
    """Cut-offs `since` to `until` - 1, which have the same history so far."""

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


def follow_tracks(
    frames: Sequence[list[Link]], present: set[tuple[int, int]], cutoffs: int, matcher: Matcher
) -> Iterator[Event]:
    """Yield the matches and mismatches of one connected component of tracks, frame by frame.

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
    """Return M after one frame, and its event: keep matches of before, match the rest, count mismatches."""
    carried = [link for link in links if owners.get(link.truth) == link.prediction]
    truths, predictions = {link.truth for link in carried}, {link.prediction for link in carried}
    rest = [link for link in links if link.truth not in truths and link.prediction not in predictions]
    if not rest:  # nearly always
        return owners, Event(since, until, [link.edge for link in carried], 0)
    fresh = _match(rest, matcher)
    now = {link.truth for link in fresh}
    before = {prediction: truth for truth, prediction in owners.items()}
    after, mismatches = dict(owners), 0
    for link in fresh:
        mismatches += link.truth in owners  # a carried pair is not fresh, so it was another prediction
        previous = before.get(link.prediction)
        if previous is not None and previous not in now:
            # A label that is there but unmatched is a miss, and not counted twice.
            mismatches += (previous, link.frame) not in present
            del after[previous]
    after.update((link.truth, link.prediction) for link in fresh)
    return after, Event(since, until, [link.edge for link in carried + fresh], mismatches)


def _match(links: list[Link], matcher: Matcher) -> list[Link]:
    pairs = [(link.prediction, link.truth, link.weight) for link in links]
    if matcher == "score_first":
        return [links[i] for i in match_by_score(pairs, [link.score for link in links])]
    return [links[i] for i in heaviest_matching(pairs)[0]]
