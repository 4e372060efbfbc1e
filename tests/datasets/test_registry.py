"""Datasets by name: ours, those that other packages add, and their one clear line where something is missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from command import ENVIRONMENT
from upvl_cli.datasets.label_registry import LABELS, flow_source, label_source
from upvl_cli.datasets.registry import DATASETS, DatasetFamily, dataset_family
from upvl_cli.errors import BadInput, BadSetting


def add_package(folder: Path, *entry_points: str) -> None:
    """A package beside others on the path, as pip leaves it, whose code is the module `extra`."""
    info = folder / "extra-0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: extra\nVersion: 0\n")
    (info / "entry_points.txt").write_text("\n".join(entry_points) + "\n")
    (folder / "extra.py").write_text("class Reader: ...\n\n\ntext = 'no dataset'\n")


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_package(
        tmp_path,
        "[upvl.datasets]",
        "absent = extra_that_is_not_installed:FAMILY",
        "misnamed = extra:FAMLY",
        "untyped = extra:text",
        "[upvl.labels]",
        "absent = extra_that_is_not_installed:labels",
        "misnamed = extra:lables",
        "untyped = extra:text",
    )
    monkeypatch.syspath_prepend(str(tmp_path))


def test_ours_are_known_by_name() -> None:
    assert set(DATASETS) == {"argoverse2", "kitti", "nuscenes", "parquet", "py123d", "synthetic", "waymo"}
    assert set(LABELS) == set(DATASETS)
    assert all(dataset_family(name) is DATASETS[name] for name in DATASETS)


def test_a_package_adds_a_dataset_and_its_labels() -> None:
    """The street of the tests is added as any other package adds one."""
    family = dataset_family("street")
    assert isinstance(family, DatasetFamily)
    dataset = family.open(Path(), None)
    assert dataset.segments == ("street-0",)
    assert len(label_source("street", Path(), dataset).frames("street-0"))
    assert flow_source("street", Path(), dataset) is not None
    assert flow_source("kitti", Path(), dataset) is None


@pytest.mark.usefixtures("added")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("absent", "the package that adds dataset 'absent' cannot be loaded: No module named 'extra_that"),
        (
            "misnamed",
            "the package that adds dataset 'misnamed' cannot be loaded: .* has no attribute 'FAMLY'",
        ),
        ("untyped", "dataset 'untyped' is a str, expected a DatasetFamily"),
        (
            "kiti",
            r"unknown dataset 'kiti'; did you mean 'kitti'\? \(known: .*absent.*kitti.*street.*synthetic",
        ),
    ],
)
def test_a_dataset_that_cannot_be_loaded_is_one_line(name: str, message: str) -> None:
    with pytest.raises(BadSetting, match=f"raw.toml: {message}") as caught:
        dataset_family(name)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("added")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("absent", "the package that adds labels of dataset 'absent' cannot be loaded: No module named"),
        ("misnamed", "the package that adds labels of dataset 'misnamed' cannot be loaded: .*'lables'"),
        ("untyped", "the labels of dataset 'untyped' are a str, expected a function"),
    ],
)
def test_labels_that_cannot_be_loaded_are_one_line(name: str, message: str) -> None:
    with pytest.raises(BadSetting, match=message) as caught:
        label_source(name, Path(), None)
    assert "\n" not in str(caught.value)


def test_without_labels_there_is_nothing_to_score() -> None:
    with pytest.raises(BadInput, match="dataset 'mine' has no labels that upvl can read"):
        label_source("mine", Path(), None)


WITHOUT_EMBREE = """
import sys


class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "embreex":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Blocker())
sys.argv = ["upvl", *sys.argv[1:]]
from upvl_cli.__main__ import main

main()
"""


def test_without_the_extra_the_built_in_city_names_it(tmp_path: Path) -> None:
    """A Python without embreex, as `pip install upvl` leaves it."""

    def command(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", WITHOUT_EMBREE, *arguments], cwd=tmp_path, capture_output=True, text=True,
            env=ENVIRONMENT,
        )  # fmt: skip

    assert command("init", ".").returncode == 0
    done = command("odometry")
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line == (
        "upvl: the dataset synthetic needs the package embreex; run: pip install 'upvl[synthetic]', "
        "or name drives of your own in stages/raw.toml"
    )
