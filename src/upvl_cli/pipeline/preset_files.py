"""Presets: folders of values that differ from those of `stages/*.toml`, and which of them a folder of shards holds."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from upvl_cli.config.toml import merge, read_toml
from upvl_cli.errors import BadSetting

# A segment becomes a file name and a word in make's rules: nothing that either could misread.
SAFE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*")
_AND = "+"  # between the names of presets


def preset_values(stages: Path, preset: str, stage: str) -> dict[str, object]:
    """Return the values of a stage that a preset, or several, change; none where there is no file of that stage.

    Raises:
        BadSetting: There is no such preset, or the file is no TOML.
    """
    if _AND in preset:
        values: dict[str, object] = {}
        for part in preset.split(_AND):
            values = merge(values, preset_values(stages, part, stage))
        return values
    path = preset_folder(stages, preset) / f"{stage}.toml"
    return read_toml(path) if os.path.lexists(path) else {}


def preset_folder(stages: Path, preset: str) -> Path:
    """Return the folder of a preset.

    Raises:
        BadSetting: There is no such preset.
    """
    folder = stages / "presets" / preset
    if not folder.is_dir():
        raise BadSetting(
            f"{folder} is missing; a preset is a folder with the values that differ, a TOML file a stage"
        )
    return folder


def preset_of(out: Path) -> str:
    """Return the preset that the shards of a folder were last made with."""
    try:
        name = (out / "preset").read_text(encoding="utf-8").strip()
    except (OSError, ValueError):
        return ""
    return name if all(SAFE_NAME.fullmatch(part) for part in name.split(_AND)) else ""


def join_presets(presets: Iterable[str]) -> str:
    """Return several presets as one, the later over the earlier."""
    return _AND.join(presets)


def split_presets(names: str) -> list[str]:
    """Return the names of presets that were joined, the later over the earlier."""
    return names.split(_AND) if names else []
