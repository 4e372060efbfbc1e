"""What an estimated error of a calibration means, in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from upvl_cli.perception.drive_check.finding import Finding, correction
from upvl_cli.perception.visual.camera_check import CalibrationOffset, tolerances
from upvl_cli.perception.visual.config import CameraCheckConfig

_CLEAR_SIGMAS = 2.0  # an axis of a faulty calibration is named from here on
_CHANCE_SIGMAS = 3.0  # outlines that lie on edges no better than this say nothing
_DELAY = 6
_AXES = ("its x axis (to the right)", "its y axis (downwards)", "its z axis (the view)")


def calibration_finding(
    camera: str, pictures: int, found: CalibrationOffset | None, min_scenes: int
) -> Finding:
    """Return the finding on the calibration of a camera.

    Args:
        camera: Its name.
        pictures: Number of its pictures.
        found: The estimated error; None where too few outlines were seen.
        min_scenes: Fewest different pictures from which a calibration is judged.
    """
    subject = f"camera {camera}"
    if found is None:
        text = f"too few outlines in {pictures} picture{'s' * (pictures != 1)} to check the calibration"
        return Finding(subject, "cannot tell", text, cause="night, fog, an empty road or few points in view")
    evidence = f"{found.scenes} different pictures of {pictures}, {found.outlines} outlines"
    if pictures < min_scenes or found.chance_sigmas < _CHANCE_SIGMAS:
        text = "too little is seen in its pictures to check the calibration to centimetres"
        return Finding(subject, "cannot tell", text, evidence=evidence)
    if found.is_fault:
        return _fault(subject, found, evidence)
    if found.is_doubtful:
        text = "its calibration or its time may be off, but its pictures disagree about it"
        return Finding(subject, "cannot tell", text, evidence=evidence)
    missed = [fault_in_words(axis, found.config) for axis in range(7) if not found.would_detect(axis)]
    text = "no fault seen in the calibration" + (f"; it would miss {', '.join(missed)}" if missed else "")
    return Finding(subject, "cannot tell" if len(missed) == 7 else "ok", text, evidence=evidence)


def _fault(subject: str, found: CalibrationOffset, evidence: str) -> Finding:
    """Return the finding on a calibration that is off, or on pictures that are late."""
    mounting, delay = " and ".join(offsets_in_words(found)), delay_in_words(found)
    remedy = "look at the calibration"
    late = correction(f"picture_delay_s = {found.delay_s:.3f}")
    if found.explained_by_delay and not found.explained_by_mounting:
        return Finding(
            subject, "fault", delay, evidence=evidence, cause="the times of the pictures are off", remedy=late
        )
    if found.explained_by_delay:
        return Finding(
            subject,
            "fault",
            f"{delay}, or its mounting is wrong by what the car moved in that time",
            evidence=evidence,
            cause="the times of the pictures, or the mounting: the car moved too evenly to tell them apart",
            remedy=f"{late}, or {remedy}",
        )
    text = mounting or "its mounting is wrong, along several axes that cannot be told apart"
    return Finding(subject, "fault", text, evidence=evidence, cause="the mounting is wrong", remedy=remedy)


def delay_in_words(found: CalibrationOffset) -> str:
    """Return the time of the pictures, in words; with its uncertainty where it is larger than that."""
    delay_ms, sigma_ms = 1000 * found.delay_s, 1000 * found.sigma[_DELAY]
    side = "later" if delay_ms > 0 else "earlier"
    size = f"by {abs(delay_ms):.0f} +- {sigma_ms:.0f} ms " if abs(delay_ms) > _CLEAR_SIGMAS * sigma_ms else ""
    about = "" if size else f", by about {abs(delay_ms):.0f} ms if the mounting is right"
    return f"its pictures were taken {size}{side} than they say{about}"


def offsets_in_words(found: CalibrationOffset) -> Iterator[str]:
    """Yield the axes along or about which a calibration is off; none that is within its own uncertainty."""
    sigmas = np.abs(found.vector) / found.sigma
    off = (np.abs(found.vector) > tolerances(found.config)) & (sigmas > _CLEAR_SIGMAS)
    for axis in np.flatnonzero(off[:_DELAY]):
        if axis < 3:
            size, sigma = np.rad2deg([found.vector[axis], found.sigma[axis]])
            yield f"rotated by {size:.2f} +- {sigma:.2f} degrees about {_AXES[axis]}"
        else:
            size, sigma = found.vector[axis] * 100, found.sigma[axis] * 100
            yield f"moved by {size:.1f} +- {sigma:.1f} cm along {_AXES[axis - 3]}"


def fault_in_words(axis: int, config: CameraCheckConfig) -> str:
    """Return a typical fault along an axis, in words."""
    if axis < 3:
        return f"{config.fault_deg:g} degree{'' if config.fault_deg == 1 else 's'} about {'xyz'[axis]}"
    if axis < _DELAY:
        return f"{100 * config.fault_m:g} cm along {'xyz'[axis - 3]}"
    return f"a delay of {1000 * config.fault_delay_s:g} ms"
