"""Pictures that are missing, empty, repeated, of another size or of another time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from upvl_cli.perception.drive_check.camera_config import PictureCheckConfig
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.types import Array, Camera, Image

_NEARLY_ALL = 98.0  # percentile: a lamp at night, or a sticker on the lens, is no picture
_STRIDE_PX = 4  # pixels that are looked at for brightness

Pictures = Mapping[int, Image]  # by step


def check_pictures(
    sample: DriveSample,
    camera: Camera,
    pictures: Mapping[int, Image | None],
    config: PictureCheckConfig,
) -> Iterator[Finding]:
    """Yield what is wrong with the pictures of one camera; nothing where they are well.

    Args:
        sample: The drive.
        camera: Its camera.
        pictures: By step, None where there is none.
        config: Limits.
    """
    subject = f"camera {camera.name}"
    seen = {step: image for step, image in pictures.items() if image is not None}
    yield from _missing(subject, sample, pictures, config)
    wrong = [image for image in seen.values() if image.rgb.shape[:2] != (camera.height_px, camera.width_px)]
    if wrong:
        height, width = wrong[0].rgb.shape[:2]
        yield Finding(
            subject,
            "fault",
            f"a picture has {width} x {height} pixels, expected {camera.width_px} x {camera.height_px}",
            evidence=f"{len(wrong)} of {len(seen)} pictures",
            cause="pictures and calibration are of different sizes",
            remedy="use pictures and calibration of one size",
        )
    delays_s = [abs(image.time_ns - sample.frames[step].time_ns) / 1e9 for step, image in seen.items()]
    if delays_s and max(delays_s) > config.max_delay_s:
        yield Finding(
            subject,
            "fault",
            f"a picture is {max(delays_s):.2f} s from its sweep, expected {config.max_delay_s} at most",
            evidence=f"{sum(delay > config.max_delay_s for delay in delays_s)} of {len(seen)} pictures",
            cause="sweeps are paired with pictures of another moment",
            remedy="look at the time stamps",
        )
    yield from _empty(subject, seen, config)
    yield from _frozen(subject, sample, seen, config)


def _missing(
    subject: str, sample: DriveSample, pictures: Mapping[int, Image | None], config: PictureCheckConfig
) -> Iterator[Finding]:
    """Yield a finding where pictures are missing."""
    without = [step for step, image in pictures.items() if image is None]
    if not without:
        return
    share = len(without) / len(pictures)
    yield Finding(
        subject,
        "fault" if share == 1 else "warning" if share > config.many_missing else "ok",
        f"no picture in {len(without)} of {len(pictures)} frames looked at",
        where=f"frame {sample.frames[without[0]].index}" + (" and others" if len(without) > 1 else ""),
        cause="the files are missing, or named otherwise than the sweeps",
        remedy="look at the names of the picture files, or remove the camera from the calibration",
    )


def _empty(subject: str, seen: Pictures, config: PictureCheckConfig) -> Iterator[Finding]:
    """Yield a finding where pictures are black, white or of one colour."""
    kinds = [picture_kind(image.rgb, config) for image in seen.values()]
    for kind in ("black", "white", "of one colour"):
        number = kinds.count(kind)
        if number:
            yield Finding(
                subject,
                "fault" if number == len(kinds) else "warning" if number > len(kinds) / 10 else "ok",
                f"{number} of {len(kinds)} pictures are {kind}",
                cause="the camera was covered, off or wrongly exposed, or the files are damaged",
                remedy="leave the camera out: nothing can be seen in its pictures",
            )


def picture_kind(rgb: Array, config: PictureCheckConfig) -> str:
    """Return "black", "white", "of one colour", or "" for a picture that shows something."""
    grey = rgb[::_STRIDE_PX, ::_STRIDE_PX].mean(axis=2)
    if np.percentile(grey, _NEARLY_ALL) < config.dark:
        return "black"
    if np.percentile(grey, 100 - _NEARLY_ALL) > config.bright:
        return "white"
    return "of one colour" if grey.std() < config.min_contrast else ""


def _frozen(
    subject: str, sample: DriveSample, seen: Pictures, config: PictureCheckConfig
) -> Iterator[Finding]:
    """Yield a finding where the car goes on and the picture stays."""
    steps = sorted(seen)
    if len(steps) < config.min_pictures or sample.world_from_ego is None:
        return
    position_m = sample.world_from_ego[steps, :3, 3]
    travel_m = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    equal = [
        np.array_equal(seen[first].rgb, seen[second].rgb) and not picture_kind(seen[first].rgb, config)
        for first, second in zip(steps, steps[1:], strict=False)
    ]
    frozen = np.array(equal) & (travel_m > config.min_travel_m)
    moved = int((travel_m > config.min_travel_m).sum())
    if frozen.any():
        yield Finding(
            subject,
            "fault" if frozen.sum() > len(steps) / 2 else "warning",
            "the same picture again while the car goes on",
            where=f"frame {sample.frames[steps[int(np.argmax(frozen)) + 1]].index}",
            evidence=f"{int(frozen.sum())} of {moved} pairs of pictures",
            cause="the camera stopped, or one picture was copied to all frames",
            remedy="look at the picture files",
        )


def check_copies(
    pictures: Mapping[str, Mapping[int, Image | None]], config: PictureCheckConfig
) -> Iterator[Finding]:
    """Yield a finding for each two cameras that show the same in all pictures.

    Args:
        pictures: By camera and step.
        config: How many pictures are needed, and when one shows something.
    """
    names = list(pictures)
    for second, other in enumerate(names):
        for name in names[:second]:
            pairs = [(image, pictures[other].get(step)) for step, image in pictures[name].items()]
            both = [(one.rgb, two.rgb) for one, two in pairs if one is not None and two is not None]
            if len(both) < config.min_pictures or picture_kind(both[0][0], config):
                continue
            if all(np.array_equal(one, two) for one, two in both):
                yield Finding(
                    f"camera {other}",
                    "fault",
                    f"shows the pictures of camera {name}",
                    evidence=f"all {len(both)} pictures",
                    cause="the pictures of one camera stand under two names",
                    remedy="look at the folders of the pictures",
                )
