"""Which stored boxes can be queried: the shards of labels or detections, and the basis of their features."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadSetting, NotMade
from upvl_cli.perception.labels.config import LookVoteConfig
from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.tables import Table, footer_digest, read_footer
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import classify
from upvl_cli.stages.picture_rows import PcaRow

STAGE_OF = {"labels": "pool-features", "detections": "detect"}
HOW_TO_MAKE = {
    "labels": "upvl autolabel --all-motion",
    "detections": "upvl train, then: upvl detect, or ask the labels: --on labels",
}


@dataclass(frozen=True)
class Store:
    """The shards that a query searches.

    Attributes:
        source: "labels" or "detections".
        paths: The shard of each drive, by its name.
        basis: Basis of the stored features.
        basis_digest: Digest of the shard that holds the basis.
        index: Folder of the search index.
        looks: How looks and points choose a word together.
    """

    source: str
    paths: dict[str, Path]
    basis: Basis
    basis_digest: str
    index: Path
    looks: LookVoteConfig


def open_store(workspace: Workspace, source: str | None) -> Store:
    """Return the shards of labels or detections; None takes detections where there are any.

    Raises:
        BadSetting: The source is neither.
        NotMade: Nothing has been made yet, or with another vision-language model than the present one.
    """
    if source is None:
        source = "detections" if _shards(workspace, "detections") else "labels"
    if source not in STAGE_OF:
        raise BadSetting(f"--on {source}: expected labels or detections")
    paths = _shards(workspace, source)
    if not paths:
        raise NotMade(f"there are no {source} with features in {workspace.out}; run: {HOW_TO_MAKE[source]}")
    basis = workspace.shard("pca", WHOLE_DATASET)
    (fitted,) = Table(basis, PcaRow)
    _check_model(workspace, basis)
    index = workspace.out / "query" / "index"
    looks = workspace.settings(classify.STAGE).looks
    return Store(source, paths, fitted.basis, footer_digest(basis), index, looks)


def _shards(workspace: Workspace, source: str) -> dict[str, Path]:
    folder = workspace.out / STAGE_OF[source]
    return {path.stem: path for path in sorted(folder.glob("*.parquet"))}


def _check_model(workspace: Workspace, basis: Path) -> None:
    if _stamp(basis).get("vlm") != workspace.model_stamp:
        raise NotMade(
            f"{basis} was made with another model than that of {workspace.stages / 'vlm.toml'}, whose words do not "
            "fit it; run: upvl autolabel --all-motion"
        )


def check_basis(store: Store, path: Path) -> None:
    """Check that the features of a shard are in the present basis.

    Raises:
        NotMade: The basis has been fitted again since.
    """
    if _stamp(path).get("inputs", {}).get("pca", store.basis_digest) != store.basis_digest:
        raise NotMade(f"{path} was made before the last pca; run: {HOW_TO_MAKE[store.source]}")


def _stamp(path: Path) -> dict[str, Any]:
    footer = read_footer(path)
    stamp = json.loads(footer.stamp) if footer else {}
    return stamp if isinstance(stamp, dict) else {}
