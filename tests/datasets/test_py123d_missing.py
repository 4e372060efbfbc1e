"""The dataset py123d where its library is missing or does not load: one line that says what to install."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from upvl_cli.datasets.registry import dataset_family
from upvl_cli.errors import BadSetting


class Blocker:
    """An importer without the library, as `pip install upvl` leaves a Python."""

    def __init__(self, error: ImportError) -> None:
        self.error = error

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if name.split(".")[0] == "py123d":
            raise self.error


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            ModuleNotFoundError("No module named 'py123d'", name="py123d"),
            "the dataset py123d needs the package py123d; run: pip install 'upvl[py123d]'",
        ),
        (
            ImportError("libGL.so.1: cannot open shared object file"),
            "the package py123d cannot be loaded: libGL.so.1: cannot open shared object file; "
            "run: pip install 'upvl[py123d]'",
        ),
    ],
)
def test_without_the_library_the_dataset_names_it(
    error: ImportError, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if "py123d" in name.split(".")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Blocker(error), *sys.meta_path])
    with pytest.raises(BadSetting) as failure:
        dataset_family("py123d").open(tmp_path, None)
    assert str(failure.value) == message
