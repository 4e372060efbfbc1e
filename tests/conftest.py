"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# As `upvl` itself has it, before numpy is loaded; and a process a core runs tests already.
for _library in ("OPENBLAS", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
# Commands that a test starts find the street of the tests there, which is added by entry points.
os.environ["PYTHONPATH"] = str(Path(__file__).parent)

# The first example of a test may wait for an import, or for other tests beside it.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of the real drives, beside the repository; tests that need it are skipped elsewhere."""
    folder = Path(__file__).parents[2] / "shared"
    if not (folder / "data").is_dir():
        pytest.skip("the real drives (../shared/data) are not here")
    return folder
