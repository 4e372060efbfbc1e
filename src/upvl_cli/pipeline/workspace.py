"""A workspace: `stages/*.toml` with every value, and `out/` with every shard."""

from __future__ import annotations

import contextlib
import difflib
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from upvl_cli.config.base import Config, setting, table
from upvl_cli.config.corrections import CorrectionsConfig
from upvl_cli.config.toml import load, merge
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.pipeline.pipeline import AnyStage, Pipeline
from upvl_cli.pipeline.preset_files import SAFE_NAME, preset_of, preset_values, split_presets
from upvl_cli.pipeline.provenance import to_json
from upvl_cli.pipeline.stage import NOT_MADE, WHOLE_DATASET, C, R, Stage
from upvl_cli.pipeline.storage.location import location
from upvl_cli.runtime.atomic import write_if_changed

if TYPE_CHECKING:
    from upvl_cli.pipeline.fingerprint import Fingerprint
    from upvl_cli.pipeline.tables import Table
    from upvl_cli.types import Dataset, Drive, Model


@dataclass(frozen=True)
class RawConfig(Config):
    """Which drives: the settings in `stages/raw.toml`."""

    dataset: str = setting("name of the dataset adapter: how the drives are stored")
    root: str = setting(
        "folder of the drives, seen from where upvl is run, or its address in an object store, such as "
        "s3://bucket/drives; the dataset synthetic has none"
    )
    segments: tuple[str, ...] = setting("names of the drives to process; an empty list takes all of them")
    immutable_files: bool = setting(
        "whether the files of a drive never change once it is there: then only new drives are looked at to find what "
        "is fresh",
        default=False,
    )
    corrections: CorrectionsConfig = table(
        "what is wrong in what the drives say of themselves", CorrectionsConfig()
    )


@dataclass(frozen=True)
class VlmConfig(Config):
    """Which vision-language model: the settings in `stages/vlm.toml`."""

    model: str = setting("the model, with a colon before its weights where it needs some: clip:/models/b16")


def nearest_of(name: str, known: Collection[str]) -> str:
    """Return a hint at the known name that is most like a given one, and some that there are."""
    most = 10_000  # comparing takes a second with that many
    close = difflib.get_close_matches(name, list(islice(known, most)), n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"{hint} (known: {', '.join(islice(known, 5))}{', ...' if len(known) > 5 else ''})"


class Workspace:
    """Where a run finds its settings and keeps its shards."""

    def __init__(self, pipeline: Pipeline, stages: Path, out: Path, preset: str | None = None) -> None:
        """Name the two folders.

        Args:
            pipeline: The stages, datasets and models that the workspace can name.
            stages: Folder of the TOML files.
            out: Folder of the shards, local or the address of one in an object store; made when the first is written.
            preset: Folder of `stages/presets` whose values stand over those of the TOML files; several are joined
                by +, the later over the earlier; "" for none, and None for what the shards in `out` were last
                made with.
        """
        self.pipeline = pipeline
        self.stages = stages
        self.out = location(out)
        self.preset = preset_of(self.out) if preset is None else preset
        self._settings: dict[str, Any] = {}
        self._drives: dict[str, Drive] = {}
        self._fingerprints: dict[str, Fingerprint] = {}

    @cached_property
    def raw(self) -> RawConfig:
        """The settings of `raw.toml`."""
        return load(RawConfig, self.stages / "raw.toml")

    @cached_property
    def dataset(self) -> Dataset:
        """The dataset that `raw.toml` names."""
        adapter = self.pipeline.dataset(self.raw.dataset)
        own = adapter.config and load(adapter.config, self.dataset_file)
        return adapter.open(self.root, own)

    @property
    def root(self) -> Path:
        """The folder of the drives that `raw.toml` names."""
        return location(self.raw.root, of_drives=True)

    @property
    def dataset_file(self) -> Path:
        """Where the dataset has settings of its own: that file; else `raw.toml`."""
        has_own = self.pipeline.dataset(self.raw.dataset).config is not None
        return self.stages / f"{self.raw.dataset if has_own else 'raw'}.toml"

    @cached_property
    def segments(self) -> tuple[str, ...]:
        """The segments to work on, in the order of their names.

        Raises:
            BadSetting: `raw.toml` names a segment that the dataset does not have.
            BadInput: A segment's name could not be a file name, or there is none at all.
        """
        known = self.dataset.segments
        if unknown := set(self.raw.segments).difference(known):
            self.check_name(min(unknown, key=self.raw.segments.index), known)
        chosen = tuple(dict.fromkeys(self.raw.segments)) or known
        if not chosen:
            raise BadInput(
                f"no drive of dataset {self.raw.dataset!r} under {self.raw.root!r}; see stages/{self.dataset_file.name}"
            )
        for name in chosen:
            if not SAFE_NAME.fullmatch(name):
                raise BadInput(
                    f"segment {name!r}: only letters, digits, '.', '_' and '-' can be used; rename it"
                )
        return chosen

    @cached_property
    def _names(self) -> frozenset[str]:
        return frozenset(self.segments)

    def check_name(self, name: str, known: Collection[str]) -> None:
        """Refuse a segment that is not among the known ones."""
        if name not in (self._names if known is self.__dict__.get("segments") else known):
            raise BadSetting(f"unknown segment {name!r}{nearest_of(name, known)}; see: upvl segments")

    def drive(self, segment: str) -> Drive:
        """Return the opened drive; only the last one stays open."""
        if segment not in self._drives:
            self.check_name(segment, self.segments)
            drive = self.dataset.open(segment)
            self._drives = {segment: self.pipeline.correct(drive, self.raw.corrections)}
        return self._drives[segment]

    def settings(self, stage: Stage[C, Any]) -> C:
        """Return the values of a stage, from its TOML file and the presets."""
        if stage.name not in self._settings:
            self._settings[stage.name] = self.with_values(stage, {})
        found: C = self._settings[stage.name]
        return found

    def with_values(self, stage: Stage[C, Any], overrides: Mapping[str, object]) -> C:
        """Return the values of a stage: those of the TOML file, of the presets over them, and others over both."""
        path = self.stages / f"{stage.name}.toml"
        differing = preset_values(self.stages, self.preset, stage.name) if self.preset else {}
        if not differing:
            return load(stage.config, path, overrides)
        load(stage.config, path)  # each file is blamed for its own faults
        try:
            return load(stage.config, path, merge(differing, overrides))
        except BadSetting as error:
            last = next(part for part in reversed(self.presets) if self.preset_file(part, stage))
            blamed = self.preset_file(last, stage)
            raise BadSetting(str(error).replace(f"{path}: ", f"{blamed}: ", 1)) from None

    @property
    def presets(self) -> list[str]:
        """The names of the presets, the later over the earlier."""
        return split_presets(self.preset)

    def preset_file(self, preset: str, stage: AnyStage) -> Path | None:
        """Return the file with the values of a stage that a preset changes; None where it changes none."""
        path = self.stages / "presets" / preset / f"{stage.name}.toml"
        return path if os.path.lexists(path) else None

    @cached_property
    def vlm(self) -> VlmConfig:
        """The settings of `vlm.toml`."""
        return load(VlmConfig, self.stages / "vlm.toml")

    @cached_property
    def model(self) -> Model:
        """The vision-language model that `vlm.toml` names; no network is loaded yet."""
        adapter, weights = self.pipeline.model(self.vlm.model)
        return adapter.open(weights)

    def shard(self, stage: str, segment: str) -> Path:
        """Return the path of a shard; `raw` has the mark of the drive's own files."""
        return self.out / stage / (f"{segment}.stamp" if stage == "raw" else f"{segment}.parquet")

    def table(self, stage: str, row: type[R], segment: str = WHOLE_DATASET) -> Table[R]:
        """Return the rows of a shard, fresh or not.

        Args:
            stage: Name of the stage.
            row: The row that it declares.
            segment: Name of the drive; left out for a stage that is made once for the whole dataset.

        Raises:
            NotMade: The shard is missing or damaged.
        """
        from upvl_cli.pipeline.tables import Table

        return Table(self.shard(stage, segment), row)

    def stage_stamp(self, stage: AnyStage, settings: Config | None = None) -> str:
        """Return as JSON what makes the shards of a stage beside the drives: its settings and those before it."""
        return to_json(self._makers(stage, settings))

    def shard_stamp(self, stage: AnyStage, segment: str, settings: Config | None = None) -> str:
        """Return as JSON what makes one shard: `stage_stamp`, and the content of the drive and of shards it reads."""
        from upvl_cli.pipeline.tables import footer_digest

        sources = self.sources(stage, segment, settings)
        made_from = {
            name: footer_digest(path) for name, path in sources if name.partition("/")[0] not in NOT_MADE
        }
        content = (
            self._digests_of(self.drives_of(stage, settings))
            if stage.is_of_dataset
            else self._fingerprint(segment).digest
        )
        makers = self.makers(stage, settings)
        made = makers | {"raw": makers["raw"] | {"content": content}}
        if digest := self.files_digest(stage, segment, settings):
            made |= {"files": {"content": digest}}
        return to_json(made | {"inputs": made_from})

    def makers(self, stage: AnyStage, settings: Config | None = None) -> dict[str, Any]:
        """Return what makes the shards of a stage, without the content of drives and inputs."""
        return self._makers(stage, settings) | {"raw": self._adapter()}

    def files_digest(self, stage: AnyStage, segment: str, settings: Config | None = None) -> str:
        """Return a digest of the files that a stage's settings name for a drive; empty where they name none."""
        files = (settings or self.settings(stage)).files(segment)
        if not files:
            return ""
        from upvl_cli.pipeline.fingerprint import kept_digest

        return kept_digest(files, self.out / stage.name / f"{segment}.seen")

    def drives_of(self, stage: AnyStage, settings: Config | None = None) -> tuple[str, ...]:
        """Return the drives that the one shard of a stage of the whole dataset is made from."""
        values = self.settings(stage) if settings is None else settings
        globs = getattr(values, "drives", ("*",))
        return tuple(name for name in self.segments if any(fnmatchcase(name, glob) for glob in globs))

    def sources(
        self, stage: AnyStage, segment: str, settings: Config | None = None
    ) -> list[tuple[str, Path]]:
        """Return the name of each input of a shard, with its drive where there are several, and its path."""
        found: list[tuple[str, Path]] = []
        for name in stage.reads:
            if name == "vlm":
                found.append((name, self.out / "vlm.stamp"))
            elif name != "raw" and self.pipeline.by_name[name].is_of_dataset:
                found.append((name, self.shard(name, WHOLE_DATASET)))
            elif stage.is_of_dataset:
                found += [
                    (f"{name}/{drive}", self.shard(name, drive)) for drive in self.drives_of(stage, settings)
                ]
            else:
                found.append((name, self.shard(name, segment)))
        return found

    def _makers(self, stage: AnyStage, settings: Config | None) -> dict[str, Any]:
        values = self.settings(stage) if settings is None else settings
        makers: dict[str, Any] = {stage.name: {"version": stage.version, "values": values.values()}}
        for name in stage.reads:
            above = (
                {name: self._given(name)}
                if name in NOT_MADE
                else self._makers(self.pipeline.by_name[name], None)
            )
            makers = above | makers
        return makers

    def _given(self, name: str) -> dict[str, Any]:
        return self._adapter() if name == "raw" else self.model_stamp

    def _adapter(self) -> dict[str, Any]:
        adapter: dict[str, Any] = {"dataset": self.raw.dataset, "version": self.dataset.version}
        own = dict(self.dataset.fingerprint_values)
        adapter |= {"values": own} if own else {}
        corrections = self.raw.corrections
        return adapter | ({} if corrections == CorrectionsConfig() else {"corrections": corrections.values()})

    @cached_property
    def model_stamp(self) -> dict[str, Any]:
        """The vision-language model as stamps have it."""
        adapter, weights = self.pipeline.model(self.vlm.model)
        from upvl_cli.pipeline.fingerprint import kept_digest

        digest = kept_digest(adapter.files(weights), self.out / "vlm.seen")
        # The value names a place on this disk; what the model is, its content says.
        model = self.vlm.model.partition(":")[0]
        return {"model": model, "version": adapter.version, "content": digest}

    def mark_model(self) -> None:
        """Write `out/vlm.stamp`, which make compares, where the model is another one."""
        write_if_changed(self.out / "vlm.stamp", to_json(self.model_stamp))

    def raw_stamp(self, segment: str) -> str:
        """Return the adapter and a digest of the content of the drive's files, as JSON."""
        return to_json(self._adapter() | {"content": self._fingerprint(segment).digest})

    def _digests_of(self, drives: Sequence[str]) -> dict[str, str]:
        """Return the digest of each drive that can be read."""
        digests = {}
        for drive in drives:
            with contextlib.suppress(BadInput):
                digests[drive] = self._fingerprint(drive).digest
        return digests

    def _fingerprint(self, segment: str) -> Fingerprint:
        if segment not in self._fingerprints:
            from upvl_cli.pipeline.fingerprint import fingerprint

            self._fingerprints[segment] = fingerprint(self.drive(segment).files, self.seen_path(segment))
        return self._fingerprints[segment]

    def seen_path(self, segment: str) -> Path:
        """Return the path of the digest of a drive's files, with their state on this disk."""
        return self.out / "raw" / f"{segment}.seen"

    def mark_raw(self, segment: str) -> Path:
        """Write `out/raw/<segment>.stamp`, which make compares, where the drive's content has changed."""
        path = self.shard("raw", segment)
        write_if_changed(path, self.raw_stamp(segment))
        write_if_changed(self.seen_path(segment), self._fingerprint(segment).cached)
        return path
