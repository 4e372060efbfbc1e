"""Whatever is done to the files of any of KITTI's layouts: all can be read, or one line says why not."""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.contract import check_drive, read_everything
from datasets.kitti.kitti_writers import write_kitti360, write_object, write_odometry, write_tracking
from tiny_kitti import write_drive
from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.datasets.kitti.labels import KittiLabels
from upvl_cli.errors import BadInput

EXAMPLES = int(os.environ.get("KITTI_DAMAGES", "60"))
LAYOUTS: dict[str, Callable[[Path], object]] = {
    "raw": lambda root: write_drive(root, frames=3),
    "object": lambda root: write_object(root, range(3)),
    "delft": lambda root: write_object(root, range(3), delft=True, suffix=".jpg"),
    "tracking": lambda root: write_tracking(root, range(3)),
    "kitti360": lambda root: write_kitti360(root, range(3)),
    "odometry": lambda root: write_odometry(root, range(3)),
}
UNDAMAGED = Path(tempfile.mkdtemp(prefix="kitti_"))


def setup_module() -> None:
    for name, write in LAYOUTS.items():
        write(UNDAMAGED / name)


def teardown_module() -> None:
    shutil.rmtree(UNDAMAGED)


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def read_all(root: Path) -> None:
    """Read all, twice where it can be read: then the drives must keep the contract, too."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refusal = read_everything(lambda: Kitti(root), lambda dataset: KittiLabels(root))
        if refusal is None:
            try:
                for segment in (kitti := Kitti(root)).segments:
                    check_drive(kitti.open(segment), max_frames=1)
            except BadInput as error:  # a folder that vanishes is none of these damages
                raise AssertionError(error) from None


NUMBERS = st.one_of(
    st.sampled_from(
        [
            "nan",
            "inf",
            "-inf",
            "0",
            "-1",
            "1e5",
            "1e20",
            "1e308",
            "1e999",
            "-1e-308",
            "9" * 400,
            "x",
            "1_0",
            "",
        ]
    ),
    st.floats().map(repr),
    st.integers(-(2**70), 2**70).map(str),
    st.text(max_size=5),
)


def damage_text(path: Path, data: st.DataObject) -> None:
    """Change words and lines of a text file."""
    lines = path.read_text().split("\n")
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(lines) - 1))
        how = data.draw(st.sampled_from(["word", "drop", "twice", "swap", "line"]))
        if how == "word":
            words = lines[place].split(" ")
            words[data.draw(st.integers(0, len(words) - 1))] = data.draw(NUMBERS)
            lines[place] = " ".join(words)
        elif how == "drop" and len(lines) > 1:
            del lines[place]
        elif how == "twice":
            lines.insert(place, lines[place])
        elif how == "swap":
            other = data.draw(st.integers(0, len(lines) - 1))
            lines[place], lines[other] = lines[other], lines[place]
        else:
            lines[place] = data.draw(st.text(max_size=30))
    path.write_text("\n".join(lines), encoding="utf-8", errors="surrogatepass")


def damage_sweep(path: Path, data: st.DataObject) -> None:
    """Change numbers, columns and the type of a sweep."""
    values = np.fromfile(path, "<f4").reshape(-1, 4).astype(np.float64)
    how = data.draw(st.sampled_from(["values", "columns", "type", "no return", "few"]))
    dtype = "<f4"
    if how == "values":
        value = data.draw(st.sampled_from([np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45, 9999.0, 0.0, -3.0]))
        column = data.draw(st.integers(0, 3))
        values[:: data.draw(st.integers(1, 7)), column] = value
    elif how == "columns":
        wide = np.column_stack(
            [values, np.arange(len(values)) % 64, np.arange(len(values)) / 3e5, values[:, 0]]
        )
        values = wide[:, : data.draw(st.integers(1, 7))]
    elif how == "type":
        dtype = data.draw(st.sampled_from([">f4", "<f8", ">f8", "<i4", "<f2", "<u1"]))
        values = np.clip(values, 0, 200) if dtype[1] in "iu" else values
    elif how == "no return":
        values[:, :3] = data.draw(st.sampled_from([np.nan, 0.0]))
    else:
        values = values[: data.draw(st.integers(0, 70))]
    values.astype(dtype).tofile(path)


def flip(content: bytes, data: st.DataObject) -> bytes:
    changed = bytearray(content)
    for _ in range(data.draw(st.integers(1, 8))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    return bytes(changed)


MARKS = (b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")
STEMS = ("7", "12", "000000000000000099", "9" * 18, "9" * 30, "a", "-1", "٣")
CONTENTS: dict[str, Callable[[bytes, st.DataObject], bytes]] = {
    "cut": lambda content, data: content[: data.draw(st.integers(0, len(content)))],
    "flip": flip,
    "empty": lambda content, data: b"",
    "noise": lambda content, data: data.draw(st.binary(max_size=200)),
    "mark": lambda content, data: data.draw(st.sampled_from(MARKS)) + content,
}


def damage_bytes(path: Path, root: Path, data: st.DataObject) -> None:
    """Cut, change, empty, replace, rename or remove a file."""
    how = data.draw(st.sampled_from([*CONTENTS, "swap", "rename", "remove", "folder", "link"]))
    if how in CONTENTS:
        path.write_bytes(CONTENTS[how](path.read_bytes(), data))
    elif how == "swap":
        shutil.copy(data.draw(st.sampled_from(files(root))), path.with_name("swapped"))
        path.with_name("swapped").rename(path)
    elif how == "rename":
        path.rename(path.with_name(data.draw(st.sampled_from(STEMS)) + path.suffix))
    else:
        path.unlink()
        if how == "folder":
            path.mkdir()
        elif how == "link":
            path.symlink_to(path.with_name("nowhere"))


@settings(max_examples=EXAMPLES)
@given(data=st.data(), layout=st.sampled_from(sorted(LAYOUTS)))
def test_damages(data: st.DataObject, layout: str) -> None:
    with tempfile.TemporaryDirectory() as name:
        root = Path(name) / "copy"
        shutil.copytree(UNDAMAGED / layout, root)
        for _ in range(data.draw(st.integers(1, 2))):
            path = data.draw(st.sampled_from(files(root)))
            how = data.draw(st.sampled_from(["bytes", "content"]))
            if how == "content" and path.suffix in (".txt", ".json", ".xml"):
                try:
                    damage_text(path, data)
                except UnicodeDecodeError:  # damaged before
                    damage_bytes(path, root, data)
            elif how == "content" and path.suffix == ".bin" and path.stat().st_size % 16 == 0:
                damage_sweep(path, data)
            elif path.stat().st_size:
                damage_bytes(path, root, data)
        read_all(root)
