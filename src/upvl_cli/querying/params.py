"""What is chosen in a query."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.stage import param


@dataclass(frozen=True)
class QueryParams:
    """Settings of `query` and `words`."""

    top: int = param("lines of the table: a track or a box without one each", least=1, most=10**6)
    candidates: int = param("objects that vote in a search, one box each", least=1, most=10**6)
    threshold: float = param("a hit has at least this score", least=0, most=1)
    same: float = param(
        "what a phrase competes with has no word this near to it, as a cosine", least=-1, most=2
    )
    moving_mps: float = param("an object moves from this speed on", "m/s", least=0.001, most=200)
