"""One evaluation from the shards to the report, its JSON and its pictures."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.errors import BadSetting, UpvlError, one_line
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.flow_score import flow_score
from upvl_cli.evaluation.gather import Material, gather
from upvl_cli.evaluation.region import Region
from upvl_cli.evaluation.report import NamedScore, Report, Scope, as_json, shown
from upvl_cli.evaluation.score import detection_scores, diagnosis, named_scores, track_scores
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import atomic_file, write_if_changed

if TYPE_CHECKING:
    from types import ModuleType

STAGE_OF = {"labels": "nms", "detections": "detect", "tracks": "nms"}


def evaluate(
    workspace: Workspace,
    what: str,
    moving_only: bool,
    class_agnostic: bool,
    region: str | None,
    overrides: Mapping[str, Any],
    segments: Collection[str] = (),
) -> Report:
    """Score the auto labels or the detections of a workspace against its labels.

    Args:
        workspace: Where.
        what: A key of `STAGE_OF`.
        moving_only: Whether only labels that move are asked for.
        class_agnostic: Whether any object is right, whatever its class; else average precision by name is told too.
        region: Length x width (m) around the car, such as `100x40`; None takes all.
        overrides: Values that replace those of `eval.toml`.
        segments: Which drives; empty takes all.

    Raises:
        BadInput: No drive has labels, or a file of labels is damaged.
        BadSetting: There is no such thing to score, or a value is wrong.
        NotMade: The auto labels are missing or were made with other settings.
    """
    if what not in STAGE_OF:
        raise BadSetting(f"--what {what!r}: expected one of {', '.join(STAGE_OF)}")
    if what == "tracks" and not class_agnostic:
        raise BadSetting(
            "tracks are scored whatever their class; run: upvl eval --what tracks --class-agnostic"
        )
    for segment in segments:
        workspace.check_name(segment, workspace.segments)
    settings = load(EvalConfig, workspace.stages / "eval.toml", overrides)
    area = Region.parse(region) if region else None
    by_class = gather(workspace, STAGE_OF[what], region=area, named=not class_agnostic, segments=segments)
    material = by_class.without_classes()
    mode = "moving-only" if moving_only else "all-motion"
    scope = _scope(what, mode, material, settings, area)
    if what == "tracks":
        return Report(scope, tracking=track_scores(material, settings, moving_only=moving_only))
    return Report(
        scope,
        detection=detection_scores(material, settings, moving_only=moving_only),
        diagnosis=diagnosis(material, settings, moving_only=moving_only),
        named=[] if class_agnostic else _named(by_class, settings, moving_only),
        flow=flow_score(workspace, settings, segments) if what == "labels" else None,
    )


def _named(material: Material, settings: EvalConfig, moving_only: bool) -> list[NamedScore]:
    """Average precision by name at each IoU."""
    moving_mps = settings.moving_mps if moving_only else None
    return [NamedScore(iou, *named_scores(material, iou=iou, moving_mps=moving_mps)) for iou in settings.iou]


def write(workspace: Workspace, report: Report) -> Iterator[Path]:
    """Write the JSON and the pictures of a report to `out/eval/`; yields the files.

    Raises:
        UpvlError: They cannot be written.
    """
    folder = workspace.out / "eval"
    path = folder / f"{report.name}.json"
    write_if_changed(path, as_json(report))
    yield path
    with _drawing() as plots:
        for name, figure in plots.plots(report):
            path = folder / f"{report.name}-{name}.png"
            with atomic_file(path) as file:
                # Without the name of the library's version: the same report gives the same bytes.
                figure.savefig(file, format="png", metadata={"Software": None})
            yield path


@contextmanager
def _drawing() -> Iterator[ModuleType]:
    """What draws a report: silent, and the same whatever a home folder or the environment say.

    It loads the drawing library, which only this needs.
    """
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    os.environ["MPLBACKEND"] = "agg"  # any other could open windows, and an unknown one stops the import
    with warnings.catch_warnings(action="ignore"):
        try:
            import matplotlib

            from upvl_cli.evaluation import plots
        except (OSError, ValueError) as error:
            raise UpvlError(
                f"matplotlib, which draws the pictures, does not start ({one_line(error)}); set MPLCONFIGDIR to "
                "a folder that can be written, and remove a damaged matplotlibrc"
            ) from None
        with matplotlib.rc_context():
            matplotlib.rcdefaults()
            yield plots


def _scope(
    what: str,
    mode: str,
    material: Material,
    settings: EvalConfig,
    region: Region | None,
) -> Scope:
    unknown = np.isnan(material.labels.velocity_mps).any(axis=1)
    return Scope(
        what=what,
        mode=mode,
        region=region,
        settings=settings,
        segments=material.segments,
        frames=material.frames,
        labels=len(material.labels),
        without_velocity=int(unknown.sum()),
        boxes=len(material.predictions),
        left_out=material.left_out,
        dropped=material.dropped,
    )


__all__ = ["STAGE_OF", "evaluate", "shown", "write"]
