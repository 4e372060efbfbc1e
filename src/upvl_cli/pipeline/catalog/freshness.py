"""Which shards of a workspace are fresh, by arrays over its segments: the answers of `runner.state`, all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from upvl_cli.config.base import Config
from upvl_cli.pipeline.catalog.catalog import Reading, Segments, stage_entries
from upvl_cli.pipeline.catalog.entries import DAMAGED, settings_text, stamp_parts
from upvl_cli.pipeline.catalog.hashing import Bools, Hashes, combine, digest_prefix, text_hash
from upvl_cli.pipeline.catalog.raw_digests import raw_digests, settings_files_digests
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.stage import NOT_MADE, WHOLE_DATASET
from upvl_cli.pipeline.tables import footer_digest, read_footer
from upvl_cli.pipeline.workspace import Workspace


@dataclass(frozen=True)
class StageFreshness:
    """The shards of one stage: n of the segments, or the one of the whole dataset (n = 1).

    Attributes:
        fresh: (n,) which were made with the present settings and inputs, which are fresh themselves.
        missing: (n,) which are not there, or no whole shard.
        ready: (n,) of which others all inputs are fresh, so that they can be made now.
        rows: Number of frames of the shards that are there.
        size_bytes: Size of the files that are there.
    """

    fresh: Bools
    missing: Bools
    ready: Bools
    rows: int
    size_bytes: int


@dataclass(frozen=True)
class Recorded:
    """What the shards of one stage record of how they were made, compared with the present settings and inputs.

    Attributes:
        matches: (n,) which are equal to the present in all but the content of the drives.
        raw: (n,) content of the drive that they were made from.
        raw_of_drives: For a shard of the whole dataset, content of each drive that it was made from.
        footer: (n,) present digests of their footers; 0 without a shard.
        missing: (n,) which are not there, or no whole shard.
        rows: Number of frames.
        size_bytes: Size of the files.
    """

    matches: Bools
    raw: Hashes
    footer: Hashes
    missing: Bools
    rows: int
    size_bytes: int
    raw_of_drives: Mapping[str, int] = field(default_factory=dict)


class Freshness:
    """The conditions of the shards of some stages and segments, and of all that they are made from."""

    def __init__(
        self,
        workspace: Workspace,
        stages: Sequence[AnyStage] | None = None,
        segments: Sequence[str] | None = None,
        settings: Mapping[str, Config] | None = None,
        reading: Reading | None = None,
    ) -> None:
        """Compare what the shards record with the present settings, drives and inputs.

        Args:
            workspace: The workspace of the shards.
            stages: The stages that are asked for; None for all.
            segments: Names of the drives; None for all.
            settings: Values of stages that run with others than those of their TOML files.
            reading: What to do about shards that the catalogue does not know.
        """
        self._workspace = workspace
        self._settings = settings or {}
        self._reading = reading or Reading()
        self._stages = _with_sources(workspace, stages)
        wanted = workspace.segments if segments is None else segments
        extra = [
            name
            for stage in self._stages
            if stage.is_of_dataset
            for name in workspace.drives_of(stage, self._settings.get(stage.name))
        ]
        self.segments: tuple[str, ...] = tuple(dict.fromkeys([*wanted, *extra]))
        self.asked = len(wanted)  # the first ones; the others are what a stage of the whole dataset reads
        self._recorded: dict[str, Recorded] = {}
        for stage in self._stages:
            self._recorded[stage.name] = (self._of_dataset if stage.is_of_dataset else self._of_segments)(
                stage
            )
        raw = self._raw()
        self.stages: dict[str, StageFreshness] = {}
        for stage in self._stages:
            self.stages[stage.name] = self._condition(stage, raw)

    def input_not_fresh(self, stage: AnyStage, place: int) -> str:
        """Return in words which input of a shard is not fresh.

        Args:
            stage: Its stage.
            place: Its place among the segments; 0 for a shard of the whole dataset.
        """
        for name in stage.reads:
            if name not in self.stages:
                continue
            is_one = self._workspace.pipeline.by_name[name].is_of_dataset
            read = [0] if is_one else self._drives(stage) if stage.is_of_dataset else [place]
            for of_input in read:
                if not self.stages[name].fresh[of_input]:
                    drive = f"/{self.segments[of_input]}" if stage.is_of_dataset and not is_one else ""
                    condition = "missing" if self.stages[name].missing[of_input] else "stale"
                    return f"{name}{drive} is {condition}"
        return ""

    @cached_property
    def _place_of(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.segments)}

    @cached_property
    def _names(self) -> Segments:
        return Segments(self.segments)

    def _values(self, stage: AnyStage) -> Config:
        values: Config = self._settings.get(stage.name) or self._workspace.settings(stage)
        return values

    def _drives(self, stage: AnyStage) -> list[int]:
        """Return the places of the drives that the one shard of a stage is made from."""
        names = self._workspace.drives_of(stage, self._settings.get(stage.name))
        return [self._place_of[name] for name in names]

    def _of_segments(self, stage: AnyStage) -> Recorded:
        entries = stage_entries(self._workspace.out, stage.name, self._names, self._reading)
        inputs = [name for name in stage.reads if name not in NOT_MADE]
        values = self._values(stage)
        settings = text_hash(settings_text(self._workspace.makers(stage, values), inputs))
        footers = [self._recorded[name].footer for name in sorted(inputs)]
        files = settings_files_digests(self._workspace, stage, self.segments, values)
        missing = entries["rows"] < 0
        matches = ~missing & (entries["settings"] == np.uint64(settings)) & (entries["files"] == files)
        matches &= entries["inputs"] == combine(footers, len(entries))
        return Recorded(
            matches=matches,
            raw=entries["raw"].copy(),
            footer=np.where(missing, np.uint64(0), entries["footer"]),
            missing=missing,
            rows=int(entries["rows"][~missing].sum()),
            size_bytes=int(entries["size_bytes"][entries["rows"] >= DAMAGED].sum()),
        )

    def _of_dataset(self, stage: AnyStage) -> Recorded:
        """Return what the one shard of a stage records: its stamp names every drive and every input."""
        path = self._workspace.shard(stage.name, WHOLE_DATASET)
        footer = read_footer(path)
        values = self._values(stage)
        drives = self._drives(stage)
        inputs: dict[str, int] = {}
        for name in stage.reads:
            if name in self._recorded:
                of_input = self._recorded[name].footer
                is_one = self._workspace.pipeline.by_name[name].is_of_dataset
                inputs |= (
                    {name: int(of_input[0])}
                    if is_one
                    else {f"{name}/{self.segments[place]}": int(of_input[place]) for place in drives}
                )
        raw: dict[str, int] = {}
        matches = False
        if footer is not None:
            try:
                parts = stamp_parts(footer.stamp)
                settings = text_hash(settings_text(self._workspace.makers(stage, values), list(inputs)))
                files = digest_prefix(self._workspace.files_digest(stage, WHOLE_DATASET, values))
                raw = {
                    name: digest_prefix(digest)
                    for name, digest in (parts.raw if isinstance(parts.raw, dict) else {}).items()
                }
                recorded = {name: digest_prefix(digest) for name, digest in parts.inputs.items()}
                matches = (parts.settings, digest_prefix(parts.files), recorded) == (settings, files, inputs)
            except (ValueError, TypeError, AttributeError):
                matches = False
        return Recorded(
            matches=np.array([matches]),
            raw=np.zeros(1, np.uint64),
            footer=np.array([digest_prefix(footer_digest(path)) if footer else 0], dtype=np.uint64),
            missing=np.array([footer is None]),
            rows=footer.rows if footer else 0,
            size_bytes=path.stat().st_size if path.exists() else 0,
            raw_of_drives=raw,
        )

    def _raw(self) -> Hashes:
        """Return the (n,) content of the drives that have shards; as recorded where drives never change."""
        needed = np.zeros(len(self.segments), bool)
        believed = np.zeros(len(self.segments), np.uint64)
        doubted = np.zeros(len(self.segments), bool)
        for stage in self._stages:
            recorded = self._recorded[stage.name]
            raw = recorded.raw
            if stage.is_of_dataset:
                needed[self._drives(stage)] |= not recorded.missing[0]
                raw = np.zeros(len(self.segments), np.uint64)
                for name, digest in recorded.raw_of_drives.items():
                    if name in self._place_of:
                        raw[self._place_of[name]] = digest
            else:
                needed |= ~recorded.missing
            doubted |= (raw != 0) & (believed != 0) & (raw != believed)
            believed = np.where(believed == 0, raw, believed)
        if not self._workspace.raw.immutable_files:
            doubted[:] = True
        asked = np.flatnonzero(needed & (doubted | (believed == 0)))
        believed[asked] = raw_digests(self._workspace, [self.segments[place] for place in asked.tolist()])
        return believed

    def _condition(self, stage: AnyStage, raw: Hashes) -> StageFreshness:
        recorded = self._recorded[stage.name]
        inputs_fresh = np.ones(1 if stage.is_of_dataset else len(self.segments), bool)
        drives = self._drives(stage) if stage.is_of_dataset else []
        for name in stage.reads:
            if name in self.stages:
                of_input = self.stages[name].fresh
                is_one = self._workspace.pipeline.by_name[name].is_of_dataset
                inputs_fresh &= of_input[drives].all() if stage.is_of_dataset and not is_one else of_input
        if stage.is_of_dataset:
            present = {self.segments[place]: int(raw[place]) for place in drives if raw[place]}
            same_raw = np.array([recorded.raw_of_drives == present])
        else:
            same_raw = (recorded.raw == raw) & (raw != 0)
        fresh = recorded.matches & same_raw & inputs_fresh
        return StageFreshness(
            fresh, recorded.missing, ~fresh & inputs_fresh, recorded.rows, recorded.size_bytes
        )


def _with_sources(workspace: Workspace, stages: Sequence[AnyStage] | None) -> tuple[AnyStage, ...]:
    """Return the stages and all those that they are made from, in their order."""
    if stages is None:
        return workspace.pipeline.stages
    wanted = {stage.name for stage in stages}
    for stage in reversed(workspace.pipeline.stages):
        if stage.name in wanted:
            wanted |= set(stage.reads)
    return tuple(stage for stage in workspace.pipeline.stages if stage.name in wanted)
