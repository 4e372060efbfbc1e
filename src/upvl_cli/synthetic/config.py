"""The settings of the made-up city: `stages/synthetic.toml`."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting

SPLITS = ("train", "val", "test")


@dataclass(frozen=True)
class CityConfig(Config):
    """How many drives there are, and how much chance may vary."""

    frames: int = setting("sweeps of each drive, 10 a second", ge=1, le=600)
    train: int = setting("drives of the split train, named train-000 and so on", ge=0, le=1000)
    val: int = setting("drives of the split val", ge=0, le=1000)
    test: int = setting("drives of the split test", ge=0, le=1000)
    seed: int = setting("another number makes other drives", ge=0, le=2**31)
    held_out: tuple[str, ...] = setting(
        "kinds of object that no drive of train has: novel ones for val and test"
    )
    density: float = setting("how many vehicles, people and things there are, beside the usual", ge=0, le=3)
    light: float = setting("how much sun, clouds and colours of the light vary, beside the usual", ge=0, le=2)
    haze: float = setting("how thick the haze may get, beside the usual", ge=0, le=10)
    noise: float = setting("noise of ranges and pictures, beside the usual", ge=0, le=10)
    rolling_s: float = setting(
        "time between the exposure of the first and the last row of a picture", "s", ge=0, le=0.1
    )
