"""A process that looks at many cities holds one at a time."""

import gc
import weakref
from pathlib import Path

from upvl_cli.config.toml import load
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.drive import CityDrive

STAGES = Path(__file__).parents[2] / "stages"


def test_a_drive_that_nobody_holds_is_freed_at_once_with_its_meshes():
    drive = CityDrive(name="x", seed=(1,), without=(), settings=load(CityConfig, STAGES / "synthetic.toml"))
    assert len(drive.points(0))
    held = weakref.ref(drive)
    gc.disable()  # Embree's meshes are large: they must not wait for a collection
    try:
        del drive
        assert held() is None
    finally:
        gc.enable()
