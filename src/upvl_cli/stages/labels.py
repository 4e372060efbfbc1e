"""The auto labels as users take them: one table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.perception.labels.classes import CLASS_NAMES, UNKNOWN
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.picture_rows import MatchBoxes2dRow
from upvl_cli.stages.rows import AmodalRow, ClassifyRow, LabelRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class LabelsConfig(Config):
    """Settings of `labels`."""

    moving_mps: float = setting(
        "speed over the ground from which a label counts as moving", "m/s", ge=0, le=200
    )


def run(inputs: Inputs, config: LabelsConfig) -> Iterator[LabelRow]:
    """Join boxes, tracks, scores and classes into the one table that users take."""
    import numpy as np

    tables, matches = inputs.table("classify", ClassifyRow), inputs.table("match-boxes2d", MatchBoxes2dRow)
    for row in inputs.table("nms", AmodalRow):
        classes, shown = tables[row.frame], matches[row.frame]
        order = np.argsort(classes.track_id)
        place = order[np.searchsorted(classes.track_id[order], row.track_id)]
        word, number = classes.word[place], classes.type[place]
        names = [CLASS_NAMES[int(k)] if text else UNKNOWN for k, text in zip(number, word, strict=True)]
        speed_mps = np.hypot(row.velocity_mps[:, 0], row.velocity_mps[:, 1])
        inputs.count("labels", len(place))
        yield LabelRow(
            **{spec.name: getattr(row, spec.name) for spec in fields(row)},
            class_name=np.array(names, dtype=np.str_),
            word=word,
            class_share=classes.share[place],
            is_moving=speed_mps >= config.moving_mps,
            num_looks=classes.num_looks[place],
            look_word=classes.look_word[place],
            look_share=classes.look_share[place],
            words_agree=classes.words_agree[place],
            iou_2d=shown.iou_2d,
            box_word=shown.word,
            box_share=shown.share,
        )


STAGE = Stage(
    name="labels", run=run, config=LabelsConfig, row=LabelRow, reads=("nms", "classify", "match-boxes2d")
)
