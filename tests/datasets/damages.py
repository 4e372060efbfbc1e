"""Damages of files, made by hypothesis: what adapters have to survive with one clear line."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from hypothesis import strategies as st


@st.composite
def file_damages(draw: Any, names: list[str]) -> tuple[str, ...]:
    """Draw what is done to files: a tuple of (kind, file, numbers) for `apply_damage`."""
    kinds = st.sampled_from(["cut", "flip", "remove", "empty", "append", "swap", "text", "repeat", "folder"])
    return (
        draw(kinds),
        draw(st.sampled_from(names)),
        draw(st.sampled_from(names)),
        draw(st.floats(0, 1)),
        draw(st.binary(min_size=1, max_size=8)),
    )


def apply_damage(root: Path, damage: tuple[Any, ...]) -> None:
    """Damage one file below a folder as `file_damages` says."""
    kind, name, other, share, content = damage
    path = root / name
    if not path.is_file():
        return
    old = path.read_bytes()
    place = int(share * max(len(old) - 1, 0))
    if kind == "remove":
        path.unlink()
    elif kind == "folder":
        path.unlink()
        path.mkdir()
    elif kind == "swap":
        if (root / other).is_file() and other != name:
            shutil.copy(root / other, path)
    else:
        path.write_bytes(
            {
                "cut": old[:place],
                "flip": old[:place] + content + old[place + len(content) :],
                "empty": b"",
                "append": old + content * 3,
                "text": content * 20,
                "repeat": old[:place] + old[place : place + 40] + old[place:],
            }[kind]
        )


def damage_bytes(data: st.DataObject, path: Path, others: list[Path]) -> None:
    """Damage one file in a way that hypothesis draws.

    Args:
        data: Where choices are drawn from.
        path: The file.
        others: Files of which one can take its place.
    """
    content = bytearray(path.read_bytes())
    how = data.draw(st.sampled_from(["cut", "flip", "remove", "empty", "swap", "folder", "noise"]))
    if how == "cut":
        path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    elif how == "flip":
        for _ in range(data.draw(st.integers(1, 8))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
        path.write_bytes(content)
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "swap":
        shutil.copy(data.draw(st.sampled_from(others)), path)
    elif how == "noise":
        path.write_bytes(data.draw(st.binary(max_size=200)))
    else:
        path.unlink()
        if how == "folder":
            path.mkdir()
