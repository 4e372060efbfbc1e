"""What is chosen in a query."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class QueryConfig(Config):
    """Settings of `query` and `words`."""

    top: int = setting("lines of the table: a track or a box without one each", ge=1, le=10**6)
    candidates: int = setting("objects that vote in a search, one box each", ge=1, le=10**6)
    threshold: float = setting("a hit has at least this score", ge=0, le=1)
    same: float = setting("what a phrase competes with has no word this near to it, as a cosine", ge=-1, le=2)
    moving_mps: float = setting("an object moves from this speed on", "m/s", ge=0.001, le=200)
