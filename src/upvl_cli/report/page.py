"""The page: templates that ship with the package, filled with every text escaped and no folder of the machine."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from upvl_cli.drawing.colours import CHANGES, CLASSES
from upvl_cli.report import figures
from upvl_cli.report.run_summary import RunSummary

if TYPE_CHECKING:
    from upvl_cli.report.changes import RunChanges

# The folders of an absolute path: they name a person's machine, and a report is handed on.
_FOLDERS = re.compile(r"(?<![\w.~-])(?:[A-Za-z]:)?/(?:[^\s/\"'<>|:;,()]+/)+(?=[^\s/])")
MOST_TEXT = 600  # characters of a value or a name: a longer one is cut


def render_page(summary: RunSummary, changes: RunChanges | None) -> str:
    """Return the page.

    Args:
        summary: What the page shows.
        changes: What changed against another run; None without one.
    """
    environment = Environment(
        loader=PackageLoader("upvl_cli.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_shareable,
    )
    environment.filters |= {
        "count": _count, "size": _size, "seconds": _seconds, "fixed": _fixed, "px": _px, "trusted": Markup,
    }  # fmt: skip
    names = ("width", "height", "left", "right", "top", "bottom", "name_width")
    layout = {name: getattr(figures, name.upper()) for name in names}
    return environment.get_template("report.html").render(
        summary=summary,
        changes=changes,
        layout=layout,
        class_colours={name: _hex(colour) for name, colour in CLASSES.items()},
        change_colours={name: _hex(colour) for name, colour in CHANGES.items()},
    )


def without_folders(text: str) -> str:
    """Return a text in which absolute paths have lost their folders: /home/me/drives/a.bin becomes …/a.bin."""
    return _FOLDERS.sub("…/", text)


def _shareable(value: Any) -> Any:
    if isinstance(value, Markup) or not isinstance(value, str):
        return value
    short = value if len(value) <= MOST_TEXT else value[: MOST_TEXT - 1] + "…"
    return without_folders(short) if "/" in short else short


def _hex(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _count(value: int) -> str:
    return f"{value:,}".replace(",", "\u202f")  # a narrow space that does not break


def _fixed(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _px(value: float) -> str:
    return f"{value:.1f}".rstrip("0").rstrip(".")


def _seconds(value: float | None) -> str:
    """Return a time in the unit that people would say it in."""
    if value is None:
        return "–"
    if value < 90:
        return f"{value:.1f} s"
    return f"{value / 60:.1f} min" if value < 5400 else f"{value / 3600:.1f} h"


def _size(value: float) -> str:
    for unit in ("B", "kB", "MB"):
        if value < 1000:
            return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"
        value /= 1000
    return f"{value:.1f} GB"
