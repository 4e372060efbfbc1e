"""A workspace: `stages/*.toml` with every value, and `out/` with every shard."""

from __future__ import annotations

import contextlib
import difflib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from upvl_cli.contents import Contents, contents
from upvl_cli.datasets import DATASETS, SETTINGS
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.settings import load, read_toml
from upvl_cli.stage import Stage, param
from upvl_cli.stages import BY_NAME
from upvl_cli.stamps import text_of
from upvl_cli.vlm import adapter

if TYPE_CHECKING:
    from upvl_cli.datasets.base import Dataset, Drive
    from upvl_cli.vlm.base import Model

# A segment becomes a file name and a word in make's rules: nothing that either could misread.
SAFE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*")


@dataclass(frozen=True)
class RawParams:
    """Which drives: the settings in `stages/raw.toml`."""

    dataset: str = param("how the drives are stored", choices=tuple(DATASETS))
    root: str = param("folder of the drives, from where upvl is run; unused by synthetic and street")
    segments: tuple[str, ...] = param("the drives to work on; an empty list takes all of them")


@dataclass(frozen=True)
class VlmParams:
    """Which vision-language model: the settings in `stages/vlm.toml`."""

    model: str = param("the model, with a colon before its weights where it needs some: clip:/models/b16")


WHOLE = "all"  # the segment of a stage that is made once for all drives
_AND = "+"  # between the names of presets
NO_STAGES = ("raw", "vlm")  # what a stage can read that no stage makes


class Workspace:
    """Where a run finds its settings and keeps its shards."""

    def __init__(self, stages: Path, out: Path, preset: str | None = None) -> None:
        """Name the two folders.

        Args:
            stages: Folder of the TOML files.
            out: Folder of the shards; made when the first is written.
            preset: Folder of `stages/presets` whose values stand over those of the TOML files; several are joined
                by +, the later over the earlier; "" for none, and None for what the shards in `out` were last
                made with.
        """
        self.stages = stages
        self.out = out
        self.preset = _preset_of(out) if preset is None else preset
        self._settings: dict[str, Any] = {}
        self._drives: dict[str, Drive] = {}
        self._seen: dict[str, Contents] = {}

    @cached_property
    def raw(self) -> RawParams:
        """The settings of `raw.toml`."""
        settings: RawParams = load(RawParams, self.stages / "raw.toml")
        return settings

    @cached_property
    def dataset(self) -> Dataset:
        """The dataset that `raw.toml` names."""
        return DATASETS[self.raw.dataset](Path(self.raw.root).expanduser(), self._dataset_settings)

    @cached_property
    def _dataset_settings(self) -> Any:
        """The values of the dataset's own TOML file; None where it has none."""
        declared = SETTINGS.get(self.raw.dataset)
        return declared and load(declared, self.stages / f"{self.raw.dataset}.toml")

    @cached_property
    def segments(self) -> tuple[str, ...]:
        """The segments to work on, in the order of their names.

        Raises:
            BadSetting: `raw.toml` names a segment that the dataset does not have.
            BadInput: A segment's name could not be a file name, or there is none at all.
        """
        known = self.dataset.segments
        for name in self.raw.segments:
            self.check_name(name, known)
        chosen = tuple(dict.fromkeys(self.raw.segments)) or known
        if not chosen:
            asked = self.raw.dataset if self.raw.dataset in SETTINGS else "raw"
            raise BadInput(
                f"no drive of dataset {self.raw.dataset!r} under {self.raw.root!r}; see stages/{asked}.toml"
            )
        for name in chosen:
            if not SAFE_NAME.fullmatch(name):
                raise BadInput(
                    f"segment {name!r}: only letters, digits, '.', '_' and '-' can be used; rename it"
                )
        return chosen

    def check_name(self, name: str, known: tuple[str, ...]) -> None:
        """Refuse a segment that is not among the known ones."""
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            few = f" (known: {', '.join(known[:5])}{', ...' if len(known) > 5 else ''})"
            raise BadSetting(f"unknown segment {name!r}{hint}{few}; see: upvl segments")

    def drive(self, segment: str) -> Drive:
        """The opened drive; only the last one is kept open."""
        if segment not in self._drives:
            self.check_name(segment, self.segments)
            self._drives = {segment: self.dataset.open(segment)}
        return self._drives[segment]

    def settings(self, stage: Stage) -> Any:
        """The values of a stage, as its TOML file gives them."""
        if stage.name not in self._settings:
            self._settings[stage.name] = self.with_values(stage, {})
        return self._settings[stage.name]

    def with_values(self, stage: Stage, overrides: Mapping[str, Any]) -> Any:
        """The values of a stage, with those of the preset over the TOML file's, and others over both."""
        path = self.stages / f"{stage.name}.toml"
        differing = preset_values(self.stages, self.preset, stage.name) if self.preset else {}
        if not differing:
            return load(stage.params, path, overrides)
        load(stage.params, path)  # each file is blamed for its own faults
        try:
            return load(stage.params, path, {**differing, **overrides})
        except BadSetting as error:
            last = next(part for part in reversed(self.presets) if self.preset_file(part, stage))
            blamed = self.preset_file(last, stage)
            raise BadSetting(str(error).replace(f"{path}: ", f"{blamed}: ", 1)) from None

    @property
    def presets(self) -> list[str]:
        """The names of the presets, the later over the earlier."""
        return self.preset.split(_AND) if self.preset else []

    def preset_file(self, preset: str, stage: Stage) -> Path | None:
        """The file with the values of a stage that a preset gives; None where it gives none."""
        path = self.stages / "presets" / preset / f"{stage.name}.toml"
        return path if os.path.lexists(path) else None

    @cached_property
    def vlm(self) -> VlmParams:
        """The settings of `vlm.toml`."""
        settings: VlmParams = load(VlmParams, self.stages / "vlm.toml")
        return settings

    @cached_property
    def model(self) -> Model:
        """The vision-language model that `vlm.toml` names; no network is loaded yet."""
        opener, weights = adapter(self.vlm.model)
        return opener.open(weights)

    def shard(self, stage: str, segment: str) -> Path:
        """Where a shard stands; `raw` stands for the mark of the drive's own files."""
        return self.out / stage / (f"{segment}.stamp" if stage == "raw" else f"{segment}.parquet")

    def stage_stamp(self, stage: Stage, settings: Any = None) -> str:
        """What makes the shards of a stage, other than the drives: its settings and those before it."""
        return text_of(self._makers(stage, settings))

    def shard_stamp(self, stage: Stage, segment: str, settings: Any = None) -> str:
        """What makes one shard: as `stage_stamp`, with the content of the drive and of the shards it reads."""
        from upvl_cli.tables import footer_digest

        sources = self.sources(stage, segment, settings)
        made_from = {
            name: footer_digest(path) for name, path in sources if name.partition("/")[0] not in NO_STAGES
        }
        content = (
            self._content_of(self.drives_of(stage, settings))
            if stage.whole
            else self._contents(segment).digest
        )
        raw = {"raw": self._adapter() | {"content": content}}
        return text_of(self._makers(stage, settings) | raw | {"inputs": made_from})

    def drives_of(self, stage: Stage, settings: Any = None) -> tuple[str, ...]:
        """The drives that the one shard of a whole stage is made from."""
        values = self.settings(stage) if settings is None else settings
        globs = getattr(values, "drives", ("*",))
        return tuple(name for name in self.segments if any(fnmatchcase(name, glob) for glob in globs))

    def sources(self, stage: Stage, segment: str, settings: Any = None) -> list[tuple[str, Path]]:
        """What a shard is made from: the name of each input, with its drive's where there are several, and its path."""
        found: list[tuple[str, Path]] = []
        for name in stage.reads:
            if name == "vlm":
                found.append((name, self.out / "vlm.stamp"))
            elif name != "raw" and BY_NAME[name].whole:
                found.append((name, self.shard(name, WHOLE)))
            elif stage.whole:
                found += [
                    (f"{name}/{drive}", self.shard(name, drive)) for drive in self.drives_of(stage, settings)
                ]
            else:
                found.append((name, self.shard(name, segment)))
        return found

    def _makers(self, stage: Stage, settings: Any) -> dict[str, Any]:
        values = self.settings(stage) if settings is None else settings
        makers: dict[str, Any] = {stage.name: {"version": stage.version, "values": asdict(values)}}
        for name in stage.reads:
            above = {name: self._given(name)} if name in NO_STAGES else self._makers(BY_NAME[name], None)
            makers = above | makers
        return makers

    def _given(self, name: str) -> dict[str, Any]:
        return self._adapter() if name == "raw" else self.model_stamp

    def _adapter(self) -> dict[str, Any]:
        adapter = {"dataset": self.raw.dataset, "version": self.dataset.version}
        return adapter | ({"values": self._dataset_settings.of_a_drive()} if self._dataset_settings else {})

    @cached_property
    def model_stamp(self) -> dict[str, Any]:
        """The vision-language model as stamps have it."""
        opener, weights = adapter(self.vlm.model)
        seen_path = self.out / "vlm.seen"
        found = contents(opener.files(weights), seen_path)
        write_if_changed(seen_path, found.seen)
        # The value names a place on this disk; what the model is, its content says.
        model = self.vlm.model.partition(":")[0]
        return {"model": model, "version": opener.version, "content": found.digest}

    def mark_model(self) -> None:
        """Write `out/vlm.stamp`, which make compares, where the model is another one."""
        write_if_changed(self.out / "vlm.stamp", text_of(self.model_stamp))

    def raw_stamp(self, segment: str) -> str:
        """The adapter and a digest of the content of the drive's files, as JSON."""
        return text_of(self._adapter() | {"content": self._contents(segment).digest})

    def _content_of(self, drives: Sequence[str]) -> dict[str, str]:
        """The digest of each drive; one that cannot be read has none."""
        digests = {}
        for drive in drives:
            with contextlib.suppress(BadInput):
                digests[drive] = self._contents(drive).digest
        return digests

    def _contents(self, segment: str) -> Contents:
        if segment not in self._seen:
            self._seen[segment] = contents(self.drive(segment).files, self._seen_path(segment))
        return self._seen[segment]

    def _seen_path(self, segment: str) -> Path:
        return self.out / "raw" / f"{segment}.seen"

    def mark_raw(self, segment: str) -> Path:
        """Write `out/raw/<segment>.stamp`, which make compares, where the drive's content has changed."""
        path = self.shard("raw", segment)
        write_if_changed(path, self.raw_stamp(segment))
        write_if_changed(self._seen_path(segment), self._contents(segment).seen)
        return path


def preset_values(stages: Path, preset: str, stage: str) -> dict[str, Any]:
    """The values of a stage that a preset, or several, give; none where there is no file of that stage.

    Raises:
        BadSetting: There is no such preset, or the file is no TOML.
    """
    if _AND in preset:
        parts = [preset_values(stages, part, stage) for part in preset.split(_AND)]
        return {name: value for part in parts for name, value in part.items()}
    path = preset_folder(stages, preset) / f"{stage}.toml"
    return read_toml(path) if os.path.lexists(path) else {}


def preset_folder(stages: Path, preset: str) -> Path:
    """Where the values of a preset stand.

    Raises:
        BadSetting: There is no such preset.
    """
    folder = stages / "presets" / preset
    if not folder.is_dir():
        raise BadSetting(
            f"{folder} is missing; a preset is a folder with the values that differ, a TOML file a stage"
        )
    return folder


def _preset_of(out: Path) -> str:
    """The preset that the shards of a folder were last made with."""
    try:
        name = (out / "preset").read_text(encoding="utf-8").strip()
    except (OSError, ValueError):
        return ""
    return name if all(SAFE_NAME.fullmatch(part) for part in name.split(_AND)) else ""


def joined(presets: Iterable[str]) -> str:
    """Several presets as one, the later over the earlier."""
    return _AND.join(presets)


def write_if_changed(path: Path, text: str) -> bool:
    """Write a small text file, whole, only where it would differ; whether it was written."""
    from upvl_cli.tables import whole

    content = text.encode("utf-8", "surrogateescape")
    with contextlib.suppress(OSError):
        if path.read_bytes() == content:
            return False
    with whole(path) as file:
        file.write(content)
    return True
