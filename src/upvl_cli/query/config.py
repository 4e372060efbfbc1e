"""Settings of text queries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from upvl_cli.config.base import Config, setting, table


@dataclass(frozen=True)
class SuggestConfig(Config):
    """Settings of `words --suggest`."""

    spread_quantile: float = setting(
        "quantile over tracks of the mean cosine distance between the boxes of a track and their mean; clusters merge "
        "whose members differ by twice that or less",
        ge=0,
        le=1,
    )
    neighbor_quantile: float = setting(
        "quantile over tracks of the cosine distance to the most similar other track; clusters merge whose members "
        "differ by twice that or less",
        ge=0,
        le=1,
    )
    max_groups: int = setting(
        "number of groups of similar tracks that are clustered; with fewer tracks each is a group of its own",
        ge=2,
        le=2000,
    )
    tie_cosine: float = setting(
        "words whose cosine is lower than the highest by no more than this are equally near, and the first of the "
        "list, which is the most general, is shown first",
        ge=0,
        le=1,
    )
    words: int = setting("number of nearest words shown of each cluster", ge=1, le=100)


@dataclass(frozen=True)
class QueryConfig(Config):
    """Settings of `query` and `words`."""

    by: Literal["vote", "mean"] = setting(
        "what classifies a box: vote lets each of its points vote for the word of highest cosine, and the looks at "
        "its track have a say; mean compares the mean feature of the box alone"
    )
    search: bool = setting(
        "whether all objects are ranked by their mean feature first, and only the best candidates classified"
    )
    candidates: int = setting(
        "number of objects, one box each, that a search classifies after the ranking", ge=1, le=10**6
    )
    index_min_boxes: int = setting(
        "number of boxes from which a search ranks by the files of upvl index, where there are any; fewer are ranked "
        "exactly",
        ge=0,
    )
    threshold: float = setting(
        "minimum score of a hit, where the score is the share of the votes times the confidence of the box",
        ge=0,
        le=1,
    )
    top: int = setting(
        "number of lines of the table; a line shows the best box of a track, or a box without a track",
        ge=1,
        le=10**6,
    )
    synonym_cosine: float = setting(
        "minimum cosine at which a default negative counts as a synonym of a queried word and does not compete",
        ge=-1,
        le=2,
    )
    hypernym_cosine: float = setting(
        "minimum cosine at which the model cannot distinguish a queried word (fire truck) from a more general "
        "negative (truck), which then does not compete; at least synonym_cosine is used",
        ge=-1,
        le=2,
    )
    moving_mps: float = setting("minimum speed of a moving object", "m/s", ge=0.001, le=200)
    sheet_objects: int = setting("number of objects in the picture of the best hits", ge=1, le=1000)
    suggest: SuggestConfig = table("How clusters of a fleet are made and named.")
