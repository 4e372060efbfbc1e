"""Columns that several tables have: what pictures say of boxes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from upvl_cli.pipeline.stage import column

if TYPE_CHECKING:
    from upvl_cli.types import Array


def num_looks() -> Any:
    """Declare how many pictures of its track were looked at."""
    return column("int32", "pictures of its track that were looked at, 0 where none shows it well", per="box")


def look_feature() -> Any:
    """Declare the mean feature of the looks at its track."""
    return column(
        "int8",
        "mean feature of the looks at its track, to be scaled by pca's steps; zeros without a look",
        per="box",
        shape=(64,),
    )


def look_word() -> Any:
    """Declare the words that the looks name."""
    return column(
        "string",
        "word that the looks at the track are nearest to, the second and the third; empty without a look",
        per="box",
        names=("look_word_1", "look_word_2", "look_word_3"),
    )


def look_share() -> Any:
    """Declare the shares of these words."""
    return column(
        "float32",
        "share that this word has among all words by the looks, 0 without a look",
        per="box",
        names=("look_share_1", "look_share_2", "look_share_3"),
    )


def words_agree() -> Any:
    """Declare whether points and looks agree."""
    return column(
        "bool",
        "whether points and looks alone give the track the same class; true where one of the two is missing",
        per="box",
    )


def point_feature() -> Any:
    """Declare the features of the points of each box."""
    return column(
        "int8",
        "values of the feature of each point of the box, to be scaled by pca's steps",
        per="box",
        shape=(64,),
        ragged=True,
    )


def without_looks(boxes: int) -> dict[str, Array]:
    """Return the columns of boxes that no picture was looked at for: a detector sees none."""
    import numpy as np

    return {"num_looks": np.zeros(boxes, np.int32), "look_feature": np.zeros((boxes, 64), np.int8)}
