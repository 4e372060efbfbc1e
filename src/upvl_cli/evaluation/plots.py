"""Plots of a report: precision over recall, and scores by range, speed and kind of error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from upvl_cli.evaluation.report import Report
from upvl_cli.evaluation.score import DetectionScore, Diagnosis
from upvl_cli.metrics.error_analysis import MissedLabels

# Colours that the colour-blind can tell apart: Okabe and Ito, Color Universal Design, 2008.
SERIES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")
RIGHT, MISPLACED, BACKGROUND = "#009E73", "#E69F00", "#8A8F98"
SIZE_IN, DPI = (6.4, 4.2), 120


def plots(report: Report) -> Iterator[tuple[str, Figure]]:
    """Yield the name and the figure of each plot of a report; a report of tracks has none."""
    area = report.scope.region
    region = f", {area.length_m:g} x {area.width_m:g} m" if area else ""
    title = f"{report.scope.what}, {report.scope.mode}, class-agnostic{region}"
    if report.detection:
        yield "precision-recall", _precision_recall(report.detection, title)
        yield "range", _by_range(report.detection, title)
    if report.diagnosis:
        yield "speed", _by_speed(report.diagnosis, title)
        yield "errors", _errors(report.diagnosis, title)


def _precision_recall(scores: Sequence[DetectionScore], title: str) -> Figure:
    figure, axes = _figure(title)
    overall = [score for score in scores if score.objects == "all"]
    for score, colour in zip(overall, _colours(len(overall)), strict=True):
        recall, precision = np.array(score.curve_recall), np.array(score.curve_precision)
        found = recall > 0
        name = f"IoU {score.iou:g}: AP {score.ap[1]:.3f}"
        axes.plot(recall[found], precision[found], color=colour, marker=".", linewidth=1.8, label=name)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.05), xlabel="recall (level 2)", ylabel="precision")
    _legend(figure, axes)
    return figure


def _by_range(scores: Sequence[DetectionScore], title: str) -> Figure:
    figure, axes = _figure(title)
    parts = [score for score in scores if score.objects != "all"]
    ious = list(dict.fromkeys(score.iou for score in parts))
    groups = list(dict.fromkeys(score.objects for score in parts))
    width = 0.8 / max(len(ious), 1)
    for number, (iou, colour) in enumerate(zip(ious, _colours(len(ious)), strict=True)):
        ap = [score.ap[1] for score in parts if score.iou == iou]
        places = np.arange(len(groups)) + (number - (len(ious) - 1) / 2) * width
        bars = axes.bar(places, ap, width * 0.92, color=colour, label=f"IoU {iou:g}")
        axes.bar_label(bars, fmt="%.2f", fontsize=8, padding=2)
    labels = {score.objects: score.labels[1] for score in parts}
    axes.set_xticks(range(len(groups)), [f"{group}\n{labels[group]} labels" for group in groups])
    axes.set(ylim=(0, 1.1), xlabel="range from the car", ylabel="average precision (level 2)")
    _legend(figure, axes)
    return figure


def _by_speed(diagnosis: Diagnosis, title: str) -> Figure:
    figure, axes = _figure(title)
    groups = _groups(diagnosis, "speed")
    recall = [1 - group.missed / group.labels for group in groups]
    bars = axes.bar(range(len(groups)), recall, 0.6, color=SERIES[0])
    axes.bar_label(bars, fmt="%.2f", fontsize=8, padding=2)
    axes.set_xticks(range(len(groups)), [f"{group.group}\n{group.labels} labels" for group in groups])
    axes.set_xlim(-0.8, max(len(groups), 3) - 0.2)
    axes.set(ylim=(0, 1.1), xlabel="speed of the label", ylabel=f"recall at IoU {diagnosis.iou:g}, any score")
    return figure


def _errors(diagnosis: Diagnosis, title: str) -> Figure:
    figure = Figure(SIZE_IN, dpi=DPI, layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(1, 2.6))
    figure.suptitle(title, fontsize=10)
    _best_boxes(above, diagnosis)
    groups = [group for split in ("points", "range", "speed", "view") for group in _groups(diagnosis, split)]
    names = [f"{group.group} ({group.labels})" for group in groups]
    bars = below.barh(names, [group.missed / group.labels for group in groups], color=SERIES[0])
    below.bar_label(bars, fmt="%.2f", fontsize=8, padding=2)
    below.set(xlim=(0, 1.1), xlabel=f"share of labels missed at IoU {diagnosis.iou:g}")
    below.invert_yaxis()
    below.tick_params(labelsize=8)
    _plain(below)
    return figure


def _best_boxes(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw one bar with the kinds of the best-scored boxes."""
    best = diagnosis.best
    counts = (best.right, best.localisation, best.background) if best else (0, 0, 0)
    left = 0
    kinds = zip(("right", "misplaced", "background"), (RIGHT, MISPLACED, BACKGROUND), counts, strict=True)
    for name, colour, boxes in kinds:
        axes.barh([""], [boxes], left=[left], color=colour, label=f"{name} {boxes}")
        left += boxes
    axes.set(xlabel=f"the best {left} boxes", xlim=(0, max(left, 1)))
    axes.legend(ncols=3, frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1))
    _plain(axes)


def _groups(diagnosis: Diagnosis, split: str) -> list[MissedLabels]:
    """Return the groups of one split that hold labels."""
    return [group for group in diagnosis.misses if group.split == split and group.labels]


def _figure(title: str) -> tuple[Figure, Axes]:
    figure = Figure(SIZE_IN, dpi=DPI, layout="constrained")
    axes = figure.subplots()
    axes.set_title(title, fontsize=10)
    axes.grid(axis="y", color="#D9DCE1", linewidth=0.6)
    axes.set_axisbelow(True)
    _plain(axes)
    return figure, axes


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)


def _legend(figure: Figure, axes: Axes) -> None:
    """Draw a legend below, where there is anything to name."""
    names = axes.get_legend_handles_labels()[1]
    if names:
        figure.legend(loc="outside lower center", ncols=len(names), frameon=False, fontsize=9)


def _colours(count: int) -> list[str]:
    return [SERIES[number % len(SERIES)] for number in range(count)]
