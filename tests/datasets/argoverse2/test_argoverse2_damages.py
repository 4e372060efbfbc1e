"""Whatever is done to the files of a log: everything can be read, or one line says why not."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.argoverse2.av2_log import write_log
from datasets.contract import read_everything
from datasets.damages import damage_bytes
from upvl_cli.datasets.argoverse2.dataset import Argoverse2
from upvl_cli.datasets.argoverse2.labels import ArgoverseLabels
from upvl_cli.errors import BadInput

EXAMPLES = 40
WHOLE = Path(tempfile.mkdtemp(prefix="av2_"))


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def setup_module() -> None:
    write_log(WHOLE)


def teardown_module() -> None:
    shutil.rmtree(WHOLE)


def read_all(root: Path) -> None:
    """Read drive, labels and ground heights."""
    read_everything(lambda: Argoverse2(root), ArgoverseLabels)
    try:
        dataset = Argoverse2(root)
        for segment in dataset.segments:
            drive = dataset.open(segment)
            for frame in drive.frames:
                assert drive.ground_z(frame.index, np.array([[5.0, 0.0, 0.0]])).shape == (1,)
    except BadInput as error:
        assert "\n" not in str(error)


VALUES = st.one_of(
    st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e5, 1e20, 1e308, 2**31, 2**63 - 1, -(2**63)]),
    st.floats(),
    st.integers(-(2**63), 2**63 - 1),
)


@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_damaged_bytes(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as name:
        root = Path(name) / "copy"
        shutil.copytree(WHOLE, root)
        damage_bytes(data, data.draw(st.sampled_from(files(root))), files(WHOLE))
        read_all(root)


@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_damaged_tables(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as name:
        root = Path(name) / "copy"
        shutil.copytree(WHOLE, root)
        path = data.draw(st.sampled_from([path for path in files(root) if path.suffix == ".feather"]))
        columns = dict(pyarrow.feather.read_table(str(path)).to_pydict())
        column = data.draw(st.sampled_from(sorted(columns)))
        how = data.draw(st.sampled_from(["value", "drop", "null", "text", "float", "repeat", "none"]))
        rows = len(columns[column])
        row = data.draw(st.integers(0, rows - 1))
        if how == "value":
            columns[column][row] = data.draw(
                VALUES if not isinstance(columns[column][row], str) else st.text()
            )
        elif how == "drop":
            del columns[column]
        elif how == "null":
            columns[column][row] = None
        elif how == "text":
            columns[column] = ["x"] * rows
        elif how == "float":
            columns[column] = [data.draw(st.floats())] * rows
        elif how == "repeat":
            columns = {key: [values[row]] * 3 + values for key, values in columns.items()}
        else:
            columns = {key: [] for key in columns}
        try:
            table = pa.table(columns)
        except (pa.ArrowException, OverflowError):
            return
        pyarrow.feather.write_feather(table, str(path), compression="uncompressed")
        read_all(root)


@settings(max_examples=20)
@given(
    text=st.text(max_size=60)
    | st.sampled_from(['{"R": [1, 0, 0, 1], "t": [1e999, 0], "s": 1}', "[[[", "\ufeff{}"])
)
def test_damaged_grid(text: str) -> None:
    with tempfile.TemporaryDirectory() as name:
        root = Path(name) / "copy"
        shutil.copytree(WHOLE, root)
        next(root.rglob("*Sim2*")).write_text(text, encoding="utf-8", errors="surrogatepass")
        read_all(root)
