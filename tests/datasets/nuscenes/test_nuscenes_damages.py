"""Whatever is done to tables and files: everything can be read, or one line says why not."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.contract import read_everything
from datasets.damages import damage_bytes
from datasets.nuscenes.nuscenes_tables import write_lyft, write_nuscenes, write_t4
from upvl_cli.datasets.nuscenes.dataset import NuScenes
from upvl_cli.datasets.nuscenes.labels import NuScenesLabels

EXAMPLES = 30
WHOLE = Path(tempfile.mkdtemp(prefix="nuscenes_"))


def setup_module() -> None:
    write_nuscenes(WHOLE / "nuscenes")
    write_lyft(WHOLE / "lyft")
    write_t4(WHOLE / "t4")


def teardown_module() -> None:
    shutil.rmtree(WHOLE)


def files(folder: Path) -> list[Path]:
    """Files of a folder; of many alike the first three."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return [path for path in found if path in sorted(path.parent.iterdir())[:3] or path.suffix == ".json"]


def copy(data: st.DataObject, name: str) -> Path:
    root = Path(name) / "copy"
    shutil.copytree(WHOLE / data.draw(st.sampled_from(["nuscenes", "lyft", "t4"])), root)
    return root


def read_all(root: Path) -> None:
    read_everything(lambda: NuScenes(root), NuScenesLabels)


@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_damaged_bytes(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as name:
        root = copy(data, name)
        damage_bytes(data, data.draw(st.sampled_from(files(root))), files(WHOLE))
        read_all(root)


VALUES = st.one_of(
    st.sampled_from(
        [
            None,
            True,
            "",
            "\0",
            "x",
            -1,
            0,
            1e20,
            1e308,
            10**400,
            [],
            {},
            [None],
            [[0]],
            "../x",
            "a" * 5000,
            "sweeps/x",
            "sweeps/\ud800",
            "sweeps/" + "a" * 300,
        ]
    ),
    st.sampled_from([[1e300] * 3, [0, 0, 0, 0], ["a", "b", "c"], [True] * 3, [1e-300, 0, 0, 0], [1e9] * 3]),
    st.floats(),
    st.integers(),
    st.text(max_size=20),
)


def damage(rows: list[dict[str, Any]], others: list[dict[str, Any]], data: st.DataObject) -> None:
    """Change a table in place."""
    how = data.draw(
        st.sampled_from(["value", "value", "value", "drop key", "drop row", "repeat", "column", "other"])
    )
    row = data.draw(st.integers(0, len(rows) - 1))
    key = data.draw(st.sampled_from(sorted(rows[row])))
    if how == "value":
        rows[row][key] = data.draw(VALUES)
    elif how == "drop key":
        del rows[row][key]
    elif how == "drop row":
        del rows[row]
    elif how == "repeat":
        rows.append(dict(rows[row]))
    elif how == "column":
        value = data.draw(VALUES)
        for each in rows:
            each[key] = value
    else:
        rows[row] = data.draw(st.sampled_from(others))


@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_damaged_tables(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as name:
        root = copy(data, name)
        paths = [path for path in files(root) if path.suffix == ".json"]
        for _ in range(data.draw(st.integers(1, 3))):
            path = data.draw(st.sampled_from(paths))
            rows = json.loads(path.read_text())
            if rows:
                damage(rows, json.loads(data.draw(st.sampled_from(paths)).read_text()) or [{}], data)
            path.write_text(json.dumps(rows))
        read_all(root)
