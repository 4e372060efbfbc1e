"""The settings of the made-up city: `stages/synthetic.toml`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from upvl_cli.config.base import Config, setting

SPLITS = ("train", "val", "test")
SensorName = Literal[
    "waymo", "kitti", "twin32", "hdl32_20hz", "hdl32_2hz", "beams40", "beams16", "lyft_5hz", "solid_state"
]
# What they are made of: synthetic/sensors.py.
SENSOR_EFFECTS: Mapping[str, str] = MappingProxyType(
    {
        "waymo": "64 beams on the roof and four LiDARs of short range, 10 Hz",
        "kitti": "64 beams 1.73 m high, 10 Hz",
        "twin32": "two stacked LiDARs of 32 uneven beams, one upside down, 10 Hz, as on the Argoverse 2 cars",
        "hdl32_20hz": "32 beams, 20 Hz, as on the nuScenes cars",
        "hdl32_2hz": "the same with two sweeps a second, as nuScenes' key frames",
        "beams40": "40 uneven beams, 10 Hz",
        "beams16": "16 beams, 10 Hz",
        "lyft_5hz": "64 beams, five sweeps a second, no intensity, as in Lyft Level 5",
        "solid_state": "a field of 120 by 25 degrees ahead, drawn line after line, 10 Hz",
    }
)


@dataclass(frozen=True)
class CityConfig(Config):
    """How many drives there are, and how much chance may vary."""

    sensor: SensorName = setting(
        "LiDARs of the car; they also set how many sweeps a second there are", effects=SENSOR_EFFECTS
    )
    frames: int = setting("sweeps of each drive", ge=1, le=600)
    train: int = setting("drives of the split train, named train-000 and so on", ge=0, le=1000)
    val: int = setting("drives of the split val", ge=0, le=1000)
    test: int = setting("drives of the split test", ge=0, le=1000)
    seed: int = setting("another number makes other drives", ge=0, le=2**31)
    held_out: tuple[str, ...] = setting(
        "kinds of object that no drive of train has: novel ones for val and test"
    )
    density: float = setting("how many vehicles, people and things there are, beside the usual", ge=0, le=3)
    clutter: float = setting(
        "how much else stands beside the street: banks, ragged bushes and hedges, wire fences; 0 for none",
        ge=0,
        le=2,
    )
    light: float = setting("how much sun, clouds and colours of the light vary, beside the usual", ge=0, le=2)
    haze: float = setting("how thick the haze may get, beside the usual", ge=0, le=10)
    noise: float = setting("noise of ranges and pictures, beside the usual", ge=0, le=10)
    rolling_s: float = setting(
        "time between the exposure of the first and the last row of a picture", "s", ge=0, le=0.1
    )
