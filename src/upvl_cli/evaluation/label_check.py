"""Checks of human labels against the points and against each other, before anything is scored with them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from upvl_cli.datasets.label_registry import label_source
from upvl_cli.datasets.shared.tracks import velocities_of_tracks
from upvl_cli.evaluation.label_fit import BoxFit
from upvl_cli.evaluation.label_meanings import label_meanings
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.label_config import LabelCheckConfig
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.types import Array, Bools, Boxes, Floats, Ints, Labels

_VEHICLE, _CYCLIST = 1, 4  # types whose heading is the way that they drive
_LARGEST_RAD = 4 * np.pi
_SMALLEST_M, _LARGEST_M = 0.05, 60.0  # a ball, and a train


def check_label_source(
    workspace: Workspace, segment: str, sample: DriveSample, config: LabelCheckConfig
) -> Iterator[Finding]:
    """Yield the findings on the labels of a drive of a workspace.

    Args:
        workspace: Names the dataset.
        segment: Name of the drive.
        sample: Its sweeps; every step can be asked for.
        config: Settings.

    Raises:
        BadInput: The drive has no labels, or they cannot be read.
    """
    source = label_source(workspace.raw.dataset, workspace.root, workspace.dataset)
    yield from check_labels(source.labels(segment), sample, config)


def check_labels(labels: Labels, sample: DriveSample, config: LabelCheckConfig) -> Iterator[Finding]:
    """Yield the findings on labels: the numbers alone, the points inside, and the motion of tracks.

    Args:
        labels: Of a whole drive, in the ego axes of their frames.
        sample: The drive.
        config: Settings.
    """
    known = np.isin(labels.frame, [frame.index for frame in sample.frames])
    if not known.all():
        yield Finding(
            "labels",
            "fault" if not known.any() else "warning",
            f"{int((~known).sum())} of {len(labels)} boxes belong to frames that the drive does not have",
            cause="labels and sweeps are numbered otherwise, or sweeps are missing",
            remedy="look at the numbers of frames in the labels",
        )
    labels = labels[known]
    sizes = list(_sizes(labels))
    yield from sizes
    if not len(labels) or any(finding.is_fault for finding in sizes):
        return
    inside = list(_points_inside(labels, sample, config))
    yield from inside
    if not any(finding.is_fault for finding in inside):
        yield from _tracks(labels, sample, config)


def _sizes(labels: Labels) -> Iterator[Finding]:
    """Yield a finding where sizes or headings are no sizes or headings."""
    large = np.abs(labels.heading_rad) > _LARGEST_RAD
    if large.any():
        yield Finding(
            "labels",
            "fault",
            f"{int(large.sum())} of {len(labels)} headings are larger than two turns",
            where=f"frame {labels.frame[np.argmax(large)]}",
            cause="headings are in degrees, expected radians",
            remedy="divide headings by 57.2958",
        )
    bad = ~np.isfinite(labels.to_rows()).all(axis=1)
    bad |= (labels.size_lwh_m < _SMALLEST_M).any(axis=1) | (labels.size_lwh_m > _LARGEST_M).any(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        size = " x ".join(f"{length:.2f}" for length in labels.size_lwh_m[first])
        yield Finding(
            "labels",
            "fault" if bad.mean() > 0.5 else "warning",
            f"{int(bad.sum())} of {len(labels)} boxes have no size of an object, the first {size} m",
            where=f"frame {labels.frame[first]}",
            cause="other units than metres, or damaged rows",
            remedy="look at the sizes in the labels",
        )


def _points_inside(labels: Labels, sample: DriveSample, config: LabelCheckConfig) -> Iterator[Finding]:
    """Yield whether boxes enclose points as they are given, or with another meaning."""
    fit = BoxFit.build(labels, sample, config)
    given = fit.shares(_as_given)
    best, best_sigmas, explanation, best_near = 0.0, 0.0, None, fit.near()
    for meaning in label_meanings(sample.world_from_ego, sample.ground_z_m):
        shares = fit.shares(meaning.apply, meaning.shift)
        near = (fit.near() | (shares > 0)) & np.isfinite(shares)
        gain, sigmas = _gain(shares[near] - given[near], fit.objects[near], config.min_objects)
        # The clearest one: a turn of the axes also helps boxes that are mirrored, but less.
        if gain > max(best, config.better_share) and sigmas > config.better_sigmas:
            best, best_sigmas, explanation, best_near = gain, sigmas, meaning, near
    objects = len(np.unique(fit.objects[best_near]))
    share = float(given[best_near].mean()) if best_near.any() else 0.0
    evidence = f"{int(best_near.sum())} boxes of {objects} objects"
    if explanation is not None:
        yield Finding(
            "labels",
            "fault",
            f"{explanation.text}: {share:.0%} of the points of an object lie inside, {share + best:.0%} so",
            evidence=f"{evidence}, {best_sigmas:.1f} standard deviations",
            cause=explanation.cause,
            remedy=explanation.remedy,
        )
    elif objects < config.min_objects:
        text = f"{objects} objects near the car are too few to compare boxes with points"
        yield Finding("labels", "cannot tell", text, evidence=evidence)
    elif share < config.low_share:
        yield Finding(
            "labels",
            "warning",
            f"boxes hold {share:.0%} of the points around them",
            evidence=evidence,
            cause="boxes lie beside their objects, or most are hidden",
            remedy="draw a frame with its labels: upvl draw",
        )
    else:
        mirrored = fit.shares(lambda boxes, step: replace(boxes, heading_rad=-boxes.heading_rad))
        blind = share - float(mirrored[best_near].mean()) < config.better_share
        text = f"boxes hold {share:.0%} of the points above the road around them"
        text += "; headings that turn the other way would not show" if blind else ""
        yield Finding("labels", "ok", text, evidence=evidence)


def _as_given(boxes: Boxes, step: int) -> Boxes:
    return boxes


def _gain(gains: Floats, objects: Ints, min_objects: int) -> tuple[float, float]:
    """Return the mean gain over boxes, and how many standard deviations over objects it is from 0."""
    sums, counts = np.bincount(objects, gains), np.bincount(objects)
    seen = counts > 0
    if seen.sum() < min_objects:
        return 0.0, 0.0
    each = sums[seen] / counts[seen]
    sigma = max(float(each.std(ddof=1)), 0.02) / np.sqrt(len(each))
    return float(gains.mean()), float(each.mean() / sigma)


def _tracks(labels: Labels, sample: DriveSample, config: LabelCheckConfig) -> Iterator[Finding]:
    """Yield contradictions between places, headings, velocities and ids of tracks."""
    poses = sample.world_from_ego
    standing = np.tile(np.eye(4), (len(sample.frames), 1, 1)) if poses is None else poses
    moved = velocities_of_tracks(replace_velocity(labels), sample.frames, standing)
    speed_mps = np.linalg.norm(moved, axis=1)
    tracked = np.isfinite(speed_mps)
    if not tracked.any():
        return
    fast = tracked & (speed_mps > config.max_speed_mps)
    if fast.sum() > config.many / 10 * tracked.sum():
        yield Finding(
            "labels",
            "warning",
            f"{int(fast.sum())} of {int(tracked.sum())} boxes moved faster than {config.max_speed_mps:g} m/s",
            where=f"frame {labels.frame[np.argmax(fast)]}",
            cause="ids change between objects, or the labels are in other axes than the poses",
            remedy="look at the ids of the labels",
        )
    if poses is None:
        return
    driving = tracked & (speed_mps > config.min_speed_mps) & ~fast
    yield from _headings(labels, moved, driving & np.isin(labels.type, (_VEHICLE, _CYCLIST)), config)
    yield from _velocities(labels, moved, driving, config)


def replace_velocity(labels: Labels) -> Labels:
    """Return the labels without velocities, so that places alone count."""
    return replace(labels, velocity_mps=np.full((len(labels), 3), np.nan))


def _headings(labels: Labels, moved: Array, driving: Bools, config: LabelCheckConfig) -> Iterator[Finding]:
    """Yield a finding where things drive backwards or sideways."""
    objects = np.unique(labels.object_id[driving])
    if len(objects) < 2:
        return
    forward = np.column_stack([np.cos(labels.heading_rad), np.sin(labels.heading_rad)])
    along = (forward * moved[:, :2]).sum(axis=1) / np.maximum(np.linalg.norm(moved[:, :2], axis=1), 1e-9)
    mean = np.array([along[driving & (labels.object_id == name)].mean() for name in objects])
    backwards, sideways = float((mean < -0.7).mean()), float((np.abs(mean) < 0.5).mean())
    for share, word, cause in (
        (backwards, "backwards", "headings are 180 degrees off"),
        (sideways, "sideways", "headings are 90 degrees off, or turn the other way"),
    ):
        if share > 0.5:
            yield Finding(
                "labels",
                "fault",
                f"{share:.0%} of what drives goes {word} by its heading",
                evidence=f"{len(objects)} moving objects",
                cause=cause,
                remedy="mend the headings; expected counter-clockwise from x, along the way that it drives",
            )


def _velocities(labels: Labels, moved: Array, driving: Bools, config: LabelCheckConfig) -> Iterator[Finding]:
    """Yield a finding where velocities contradict places."""
    both = driving & np.isfinite(labels.velocity_mps[:, :2]).all(axis=1)
    if len(np.unique(labels.object_id[both])) < 2:
        return
    wrong_mps = np.linalg.norm((labels.velocity_mps - moved)[:, :2], axis=1)
    wrong = wrong_mps > 1.0 + 0.3 * np.linalg.norm(moved[:, :2], axis=1)
    share = float(wrong[both].mean())
    if share > max(config.many, 0.3):
        yield Finding(
            "labels",
            "warning",
            f"velocities contradict the places of {share:.0%} of the moving boxes",
            evidence=f"{int(both.sum())} boxes",
            cause="velocities relative to the car or along the axes of the world, or in other units",
            remedy="expected velocities over the ground along the ego axes, in m/s",
        )
