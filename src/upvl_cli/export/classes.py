"""Names of classes: those of upvl in the words of a format, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from upvl_cli.export.drive import Losses
from upvl_cli.export.format import ExportFormat
from upvl_cli.types import Array


def extended_class_map(known: Mapping[str, str], names: Iterable[str], fmt: ExportFormat) -> dict[str, str]:
    """Return the format's name of each class; no two share one, and those that are known keep theirs.

    Args:
        known: The names so far.
        names: Classes in the words of upvl.
        fmt: The format.
    """
    mapped = dict(known)
    for name in sorted(set(names) - set(known), key=lambda name: (name not in fmt.classes, name)):
        own, number = own_name(name), 1
        native = fmt.classes.get(name, own)
        while native in mapped.values():
            native, number = own if number == 1 else f"{own}_{number}", number + 1
        mapped[name] = native
    return mapped


def own_name(name: str) -> str:
    """Return a name as one word: some formats separate their columns by blanks."""
    return "_".join(name.split()) or "unknown"


def count_unknown(names: Array, fmt: ExportFormat, losses: Losses) -> None:
    """Count the boxes whose class the tools of a format do not know."""
    if not fmt.fixed_classes:
        return
    for name, boxes in zip(*np.unique(names, return_counts=True), strict=True):
        if str(name) not in fmt.classes:
            losses[f"boxes of class {str(name)!r}, which is none of the format: written by that name"] += int(
                boxes
            )


def renamed(names: Array, table: Mapping[str, str]) -> Array:
    """Return names in other words; one that is not in the table stays."""
    return np.array([table.get(str(name), str(name)) for name in names], dtype=str)


def upvl_names(fmt: ExportFormat, manifest: Mapping[str, str]) -> dict[str, str]:
    """Return the class of upvl by class of the format.

    Args:
        fmt: The format.
        manifest: The same table as the export kept it; empty where a tool has not kept that file.
    """
    plain: dict[str, str] = {}
    for name, native in fmt.classes.items():
        plain.setdefault(native, name)
    return plain | dict(manifest)
