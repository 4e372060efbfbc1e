"""Unsupervised 3D perception with vision-language distillation (UP-VL, ICCV 2023).

`open("out").labels()` gives the auto labels of a workspace as a table; docs/scripts.md shows what else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from os import PathLike

    from upvl_cli.results.results import Results

__all__ = ["__version__", "open"]

__version__: str


def open(out: str | PathLike[str] = "out", stages: str | PathLike[str] | None = None) -> Results:
    """Open the results of a workspace for reading.

    Args:
        out: The folder of the results.
        stages: The folder of the settings, which queries, points and recordings need; None takes the folder `stages`
            beside `out`.

    Returns:
        Tables of labels, detections, tracks, flow and points; queries; recordings for a viewer.

    Raises:
        BadSetting: The folder is not there, or holds no results of upvl.
    """
    from upvl_cli.results.results import Results

    return Results(out, stages)


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version  # slow to import, and seldom needed

    return version("upvl")
