"""Which settings made the labels: those that differ from the package's own, and between two runs."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from upvl_cli.commands.init import shipped_workspace
from upvl_cli.config.toml import read_toml
from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.provenance import flatten
from upvl_cli.pipeline.tables import read_footer
from upvl_cli.pipeline.workspace import Workspace

_NO_SETTINGS = (".content", ".version")  # ends of names of a stamp that are digests and versions


@dataclass(frozen=True)
class SettingChange:
    """A setting with two values."""

    name: str
    before: str
    after: str


@dataclass(frozen=True)
class Provenance:
    """What made the labels of some drives.

    Attributes:
        upvl_version: Version of the installed package.
        values: Value of each setting by its full name, as the stamps of the shards have it.
        versions: Version of each stage, of the dataset's adapter and of the model, by name.
        input_digests: Digest of what was read, by name: the model's files, and the drive's of one drive.
        digests: Digest of the stamp of the labels, by drive.
        mixed: Number of drives whose labels were made with other settings than those of the most drives.
    """

    upvl_version: str
    values: Mapping[str, Any]
    versions: Mapping[str, Any]
    input_digests: Mapping[str, str]
    digests: Mapping[str, str]
    mixed: int


def provenance_of(workspace: Workspace, segments: Sequence[str]) -> Provenance:
    """Return what made the labels of some drives, as the stamps of their shards say."""
    stamp_of = {}
    for segment in segments:
        footer = read_footer(workspace.shard("labels", segment))
        if footer is not None:
            stamp_of[segment] = footer.stamp
    flat = {segment: flatten(stamp) for segment, stamp in stamp_of.items()}
    makers = {segment: json.dumps(_settings_in(values), sort_keys=True) for segment, values in flat.items()}
    usual, drives = next(iter(Counter(makers.values()).most_common(1)), ("{}", 0))
    values: dict[str, Any] = json.loads(usual)
    one = next((flat[segment] for segment, made in makers.items() if made == usual), {})
    detect = next((f.stamp for s in segments if (f := read_footer(workspace.shard("detect", s)))), "")
    flat_detect = flatten(detect)
    everything = flat_detect | one
    names = {"vlm.content": "files of the model"}
    if len(stamp_of) == 1:
        names["raw.content"] = "files of the drive"
    return Provenance(
        upvl_version=_package_version(),
        values=_settings_in(flat_detect) | values,
        versions={
            name.removesuffix(".version"): value
            for name, value in everything.items()
            if name.endswith(".version") and name.count(".") == 1
        },
        input_digests={name: str(everything[key])[:16] for key, name in names.items() if key in everything},
        digests={segment: hashlib.sha256(stamp.encode()).hexdigest()[:16] for segment, stamp in stamp_of.items()},
        mixed=len(stamp_of) - drives,
    )  # fmt: skip


def changed_settings(workspace: Workspace, values: Mapping[str, Any]) -> tuple[SettingChange, ...]:
    """Return the settings whose values differ from those that the package ships.

    Args:
        workspace: Names the stages.
        values: Value of each setting by its full name.
    """
    shipped = dict(_shipped_values(workspace))
    known = shipped.keys() & values.keys()
    return settings_between({name: shipped[name] for name in known}, {name: values[name] for name in known})


def settings_between(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[SettingChange, ...]:
    """Return the settings with two values, by name; those of a stage that only one run has made do not count.

    Args:
        before: Value of each setting by its full name.
        after: The same of another run.
    """
    stages = stages_in(before) & stages_in(after)
    return tuple(
        SettingChange(name, _text(before, name), _text(after, name))
        for name in sorted(set(before) | set(after))
        if name.partition(".")[0] in stages
        and (before.get(name) != after.get(name) or (name in before) != (name in after))
    )


def stages_in(values: Mapping[str, Any]) -> set[str]:
    """Return the stages that settings belong to, by the first part of their names."""
    return {name.partition(".")[0] for name in values}


def _shipped_values(workspace: Workspace) -> Iterator[tuple[str, Any]]:
    """Yield each setting of the package with the value that it ships."""
    folder = shipped_workspace() / "stages"
    made = {
        stage.name: {"values": read_toml(folder / f"{stage.name}.toml")}
        for stage in workspace.pipeline.stages
    }
    yield from flatten(json.dumps(made)).items()
    raw = read_toml(folder / "raw.toml")
    yield "raw.dataset", raw["dataset"]
    yield "vlm.model", str(read_toml(folder / "vlm.toml")["model"]).partition(":")[0]
    try:
        if workspace.raw.dataset == raw["dataset"]:  # its own settings are of no meaning elsewhere
            own = {"raw": {"values": read_toml(folder / f"{raw['dataset']}.toml")}}
            yield from flatten(json.dumps(own)).items()
    except UpvlError:  # the settings of the workspace are gone or damaged; its shards are not
        return


def _settings_in(flat: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: value
        for name, value in flat.items()
        if not name.endswith(_NO_SETTINGS) and not name.startswith(("inputs.", "files."))
    }


def _text(values: Mapping[str, Any], name: str) -> str:
    return json.dumps(values[name], ensure_ascii=False) if name in values else "none"


def _package_version() -> str:
    try:
        return version("upvl")
    except PackageNotFoundError:
        return "unknown"
