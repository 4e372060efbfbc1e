"""Where the objects are that can be asked for, and what their features are kept in."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from upvl_cli.algorithms.open_vocabulary import Basis
from upvl_cli.errors import BadSetting, NotMade
from upvl_cli.stages import BY_NAME
from upvl_cli.tables import Table, footer_digest, read_footer
from upvl_cli.workspace import WHOLE, Workspace

STAGE_OF = {"labels": "describe", "detections": "detect"}
HOW_TO_MAKE = {
    "labels": "upvl autolabel --all-motion",
    "detections": "upvl train, then: upvl detect, or ask the labels: --on labels",
}


@dataclass(frozen=True)
class Store:
    """The shards to search.

    Attributes:
        on: "labels" or "detections".
        paths: The shard of each drive, by its name.
        basis: What the features are kept in.
        index: Where the search index stands.
    """

    on: str
    paths: dict[str, Path]
    basis: Basis
    index: Path


def store(workspace: Workspace, on: str | None) -> Store:
    """Find the shards of labels or detections; by default of detections where there are any.

    Raises:
        BadSetting: There is nothing of that name.
        NotMade: Nothing has been made yet, or with another model or another basis than there is now.
    """
    if on is None:
        on = "detections" if _shards(workspace, "detections") else "labels"
    if on not in STAGE_OF:
        raise BadSetting(f"--on {on}: expected labels or detections")
    paths = _shards(workspace, on)
    if not paths:
        raise NotMade(f"there are no {on} with features in {workspace.out}; run: {HOW_TO_MAKE[on]}")
    basis = workspace.shard("pca", WHOLE)
    (fitted,) = Table(basis, BY_NAME["pca"].row)
    _check_model(workspace, basis)
    _check_basis(on, paths.values(), footer_digest(basis))
    return Store(on, paths, fitted.basis, workspace.out / "query" / f"index-{on}.arrow")


def _shards(workspace: Workspace, on: str) -> dict[str, Path]:
    folder = workspace.out / STAGE_OF[on]
    return {path.stem: path for path in sorted(folder.glob("*.parquet"))}


def _check_model(workspace: Workspace, basis: Path) -> None:
    if _stamp(basis).get("vlm") != workspace.model_stamp:
        raise NotMade(
            f"{basis} was made with another model than that of {workspace.stages / 'vlm.toml'}, whose words do not "
            "fit it; run: upvl autolabel --all-motion"
        )


def _check_basis(on: str, paths: Iterable[Path], digest: str) -> None:
    """Refuse features that were rounded in a basis that has since been fitted anew."""
    for path in paths:
        if _stamp(path).get("inputs", {}).get("pca", digest) != digest:
            raise NotMade(f"{path} was made before the last pca; run: {HOW_TO_MAKE[on]}")


def _stamp(path: Path) -> dict[str, Any]:
    footer = read_footer(path)
    stamp = json.loads(footer.stamp) if footer else {}
    return stamp if isinstance(stamp, dict) else {}
