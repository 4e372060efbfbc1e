"""One evaluation: from the shards to the report, its JSON and its plots."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.errors import BadSetting, UpvlError, one_line
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.flow_score import flow_score
from upvl_cli.evaluation.gather import HUMAN_LABELS, TRUTHS, Material, gather
from upvl_cli.evaluation.region import Region
from upvl_cli.evaluation.report import NamedScore, Report, Scope, as_json, render
from upvl_cli.evaluation.score import detection_scores, diagnosis, named_scores, track_scores
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import atomic_file, write_if_changed
from upvl_cli.stages import mask

if TYPE_CHECKING:
    from types import ModuleType

# What can be scored, and the stage that makes its boxes.
STAGE_OF = {"labels": "nms", "detections": "detect", "tracks": "nms"}


def evaluate(
    workspace: Workspace,
    what: str,
    moving_only: bool | None,
    class_agnostic: bool,
    region: str | None,
    overrides: Mapping[str, Any],
    segments: Collection[str] = (),
    truth: str = HUMAN_LABELS,
) -> Report:
    """Score the auto labels, tracks or detections of a workspace against human labels.

    Args:
        workspace: The workspace whose shards are scored.
        what: A key of `STAGE_OF`.
        moving_only: Whether only moving labels count; None counts those that the auto labels are meant to hold.
        class_agnostic: Whether all objects are of one class; else the average precision by class comes on top.
        region: Length x width (m) around the car, such as `100x40`; None takes all.
        overrides: Values that replace those of `eval.toml`.
        segments: Names of the drives; empty takes all.
        truth: A key of `TRUTHS`.

    Raises:
        BadInput: No drive has labels, or a file of labels is damaged.
        BadSetting: There is no such thing to score, or a value is wrong.
        NotMade: The boxes are missing or were made with other settings.
    """
    if what not in STAGE_OF:
        raise BadSetting(f"--what {what!r}: expected one of {', '.join(STAGE_OF)}")
    if what == "tracks" and not class_agnostic:
        raise BadSetting(
            "tracks are scored whatever their class; run: upvl eval --what tracks --class-agnostic"
        )
    if truth not in TRUTHS:
        raise BadSetting(f"--truth {truth!r}: expected one of {', '.join(TRUTHS)}")
    for segment in segments:
        workspace.check_name(segment, workspace.segments)
    settings = load(EvalConfig, workspace.stages / "eval.toml", overrides)
    area = Region.parse(region) if region else None
    by_class = gather(
        workspace, STAGE_OF[what], region=area, named=not class_agnostic, segments=segments, truth=truth
    )
    material = by_class.without_classes()
    if moving_only is None:
        moving_only = labels_only_moving(workspace)
    mode = "moving-only" if moving_only else "all-motion"
    scope = replace(_scope(what, mode, by_class, settings, area), truth=truth)
    if what == "tracks":
        return Report(scope, tracking=track_scores(material, settings, moving_only=moving_only))
    return Report(
        scope,
        detection=detection_scores(material, settings, moving_only=moving_only),
        diagnosis=diagnosis(material, settings, moving_only=moving_only),
        named=[] if class_agnostic else _named(by_class, settings, moving_only),
        flow=flow_score(workspace, settings, segments) if (what, truth) == ("labels", HUMAN_LABELS) else None,
    )


def labels_only_moving(workspace: Workspace) -> bool:
    """Return whether the auto labels of a workspace hold moving objects only: its eps_sf is above 0 (UP-VL, 3.1).

    Args:
        workspace: The workspace, with the preset that its shards were last made with.
    """
    return workspace.settings(mask.STAGE).min_speed_mps > 0


def _named(material: Material, settings: EvalConfig, moving_only: bool) -> list[NamedScore]:
    """Return the average precision by class at each IoU."""
    moving_mps = settings.moving_mps if moving_only else None
    return [NamedScore(iou, *named_scores(material, iou=iou, moving_mps=moving_mps)) for iou in settings.iou]


def write(workspace: Workspace, report: Report) -> Iterator[Path]:
    """Write the JSON and the plots of a report to `out/eval/`; yields the paths.

    Args:
        workspace: The workspace that was scored.
        report: Its report.

    Raises:
        UpvlError: They cannot be written.
    """
    folder = workspace.out / "eval"
    path = folder / f"{report.name}.json"
    write_if_changed(path, as_json(report))
    yield path
    with _drawing_library() as plots:
        for name, figure in plots.plots(report):
            path = folder / f"{report.name}-{name}.png"
            with atomic_file(path) as file:
                # Without the name of the library's version: the same report gives the same bytes.
                figure.savefig(file, format="png", metadata={"Software": None})
            yield path


@contextmanager
def _drawing_library() -> Iterator[ModuleType]:
    """Give the module of the plots, silent and independent of a home folder and the environment.

    matplotlib is loaded here, for only this needs it.
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
    has_no_velocity = np.isnan(material.labels.velocity_mps).any(axis=1)
    return Scope(
        what=what,
        mode=mode,
        region=region,
        settings=settings,
        segments=material.segments,
        frames=material.frames,
        labels=len(material.labels),
        without_velocity=int(has_no_velocity.sum()),
        boxes=len(material.predictions),
        left_out=material.left_out,
        dropped=material.dropped,
    )


__all__ = ["STAGE_OF", "evaluate", "render", "write"]
