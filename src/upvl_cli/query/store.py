"""Where the objects are that can be asked for, and what their features are kept in."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadSetting, NotMade
from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.tables import Table, footer_digest, read_footer
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import PcaRow

STAGE_OF = {"labels": "pool-features", "detections": "detect"}
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
        basis_digest: Of the shard that holds it.
        index: Where the search index stands.
    """

    on: str
    paths: dict[str, Path]
    basis: Basis
    basis_digest: str
    index: Path


def store(workspace: Workspace, on: str | None) -> Store:
    """Find the shards of labels or detections; by default of detections where there are any.

    Raises:
        BadSetting: There is nothing of that name.
        NotMade: Nothing has been made yet, or with another model than there is now.
    """
    if on is None:
        on = "detections" if _shards(workspace, "detections") else "labels"
    if on not in STAGE_OF:
        raise BadSetting(f"--on {on}: expected labels or detections")
    paths = _shards(workspace, on)
    if not paths:
        raise NotMade(f"there are no {on} with features in {workspace.out}; run: {HOW_TO_MAKE[on]}")
    basis = workspace.shard("pca", WHOLE_DATASET)
    (fitted,) = Table(basis, PcaRow)
    _check_model(workspace, basis)
    digest = footer_digest(basis)
    return Store(on, paths, fitted.basis, digest, workspace.out / "query" / f"index-{on}.arrow")


def _shards(workspace: Workspace, on: str) -> dict[str, Path]:
    folder = workspace.out / STAGE_OF[on]
    return {path.stem: path for path in sorted(folder.glob("*.parquet"))}


def _check_model(workspace: Workspace, basis: Path) -> None:
    if _stamp(basis).get("vlm") != workspace.model_stamp:
        raise NotMade(
            f"{basis} was made with another model than that of {workspace.stages / 'vlm.toml'}, whose words do not "
            "fit it; run: upvl autolabel --all-motion"
        )


def check_basis(store: Store, path: Path) -> None:
    """Refuse features that were rounded in a basis that has since been fitted anew.

    Raises:
        NotMade: They were.
    """
    if _stamp(path).get("inputs", {}).get("pca", store.basis_digest) != store.basis_digest:
        raise NotMade(f"{path} was made before the last pca; run: {HOW_TO_MAKE[store.on]}")


def _stamp(path: Path) -> dict[str, Any]:
    footer = read_footer(path)
    stamp = json.loads(footer.stamp) if footer else {}
    return stamp if isinstance(stamp, dict) else {}
