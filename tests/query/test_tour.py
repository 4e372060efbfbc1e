"""The notebook of the docs runs from end to end on a workspace, and ships without outputs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from stored import Thing, workspace

from command import ROOT
from drive_shards import CAR, SEGMENT, write_street_shards

NOTEBOOK = ROOT / "docs" / "tour.ipynb"


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    pytest.importorskip("pandas")
    made = workspace(tmp_path, {SEGMENT: [Thing({"car": 9}, track=CAR, frames=(1, 2))]}, frames=3)
    write_street_shards(made, 3)
    monkeypatch.setenv("UPVL_OUT", str(made.out))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    # Matplotlib may build its list of fonts in the first cell.
    client = nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    shown = ["".join(map(str, cell.outputs)) for cell in notebook.cells if cell.cell_type == "code"]
    assert SEGMENT in shown[0]
    assert "pedestrian" in shown[2]
    assert "image/png" in shown[3]
    assert "car" in shown[4]
    assert "flow_x_mps" in shown[5]
    assert "image/png" in shown[6]
    assert not [output for cell in notebook.cells for output in cell.get("outputs", []) if "ename" in output]


def test_the_notebook_ships_without_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert not [cell for cell in cells if cell.get("outputs") or cell.get("execution_count")]
