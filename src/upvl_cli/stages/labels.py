"""The auto labels as users take them: one table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Inputs, Stage
from upvl_cli.stages.rows import AmodalRow, ClassifyRow, LabelRow


@dataclass(frozen=True)
class LabelsConfig(Config):
    """Settings of `labels`."""

    moving_mps: float = setting(
        "speed over the ground from which a label counts as moving", "m/s", ge=0, le=200
    )


def run(inputs: Inputs, config: LabelsConfig) -> Iterator[LabelRow]:
    """Join boxes, tracks, scores and classes into the one table that users take."""
    import numpy as np

    class_names = {1: "vehicle", 2: "pedestrian", 4: "cyclist"}
    classes = inputs.table("classify", ClassifyRow)
    for row in inputs.table("nms", AmodalRow):
        found = classes[row.frame]
        order = np.argsort(found.track_id)
        place = order[np.searchsorted(found.track_id[order], row.track_id)]
        word, kind = found.word[place], found.type[place]
        speed_mps = np.hypot(row.velocity_mps[:, 0], row.velocity_mps[:, 1])
        inputs.count("labels", len(place))
        yield LabelRow(
            **{spec.name: getattr(row, spec.name) for spec in fields(row)},
            class_name=np.array(
                [class_names.get(int(k), "other" if w else "") for k, w in zip(kind, word, strict=True)],
                dtype=np.str_,
            ),
            word=word,
            class_share=found.share[place],
            is_moving=speed_mps >= config.moving_mps,
        )


STAGE = Stage(name="labels", run=run, config=LabelsConfig, row=LabelRow, reads=("nms", "classify"))
