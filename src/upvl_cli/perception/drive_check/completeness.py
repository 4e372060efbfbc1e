"""What is left of a drive after its data set left out what it cannot use."""

from __future__ import annotations

from collections.abc import Iterator

from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.sample import DriveSample

_MANY_SHARE = 0.1  # of the sweeps: fewer are the usual loss at the ends of a recording
_PICTURE, _SWEEP = ("picture", "image"), ("sweep", "iteration")


def check_completeness(sample: DriveSample) -> Iterator[Finding]:
    """Yield what was left out: a warning where that is over a tenth of the sweeps, or every picture."""
    total = len(sample.frames)
    pictures = {reason: count for reason, count in sample.skipped.items() if _is_about(reason, _PICTURE)}
    sweeps = {
        reason: count
        for reason, count in sample.skipped.items()
        # A time without a sweep was never a sweep: a part of a recording has such times before and after it.
        if reason not in pictures and _is_about(reason, _SWEEP) and not reason.startswith("no ")
    }
    lost = sum(sweeps.values())
    is_many = lost > _MANY_SHARE * (total + lost)
    if is_many:
        yield Finding(
            "drive",
            "warning",
            f"{lost} of {total + lost} sweeps were left out: {_in_words(sweeps)}",
            cause="files are missing, or times, poses and sweeps have other numbers",
            remedy="look at the names and numbers of the files",
        )
    if pictures and not _has_picture(sample):
        yield Finding(
            "pictures",
            "warning",
            f"no sweep has a picture: {_in_words(pictures)}",
            cause="pictures have other names, times or numbers than the data set expects",
            remedy="look at the names of the pictures; without any, labels have no words",
        )
        pictures = {}
    rest = {
        reason: count
        for reason, count in sample.skipped.items()
        if not (is_many and reason in sweeps) and (reason in pictures or not _is_about(reason, _PICTURE))
    }
    if rest:
        yield Finding("drive", "ok", f"left out: {_in_words(rest)}")


def _is_about(reason: str, words: tuple[str, ...]) -> bool:
    return any(word in reason for word in words)


def _has_picture(sample: DriveSample) -> bool:
    return any(
        sample.picture(step, camera.name) is not None for camera in sample.cameras for step in sample.steps
    )


def _in_words(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in counts.items())
