"""The settings of the made-up city: `stages/synthetic.toml`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from upvl_cli.stage import param

SPLITS = ("train", "val", "test")


@dataclass(frozen=True)
class CityParams:
    """How many drives there are, and how much chance may vary."""

    frames: int = param("sweeps of each drive, 10 a second", least=1, most=600)
    train: int = param("drives of the split train, named train-000 and so on", least=0, most=1000)
    val: int = param("drives of the split val", least=0, most=1000)
    test: int = param("drives of the split test", least=0, most=1000)
    seed: int = param("another number makes other drives", least=0, most=2**31)
    held_out: tuple[str, ...] = param(
        "kinds of object that no drive of train has: novel ones for val and test"
    )
    density: float = param(
        "how many vehicles, people and things there are, beside the usual", least=0, most=3
    )
    light: float = param(
        "how much sun, clouds and colours of the light vary, beside the usual", least=0, most=2
    )
    haze: float = param("how thick the haze may get, beside the usual", least=0, most=10)
    noise: float = param("noise of ranges and pictures, beside the usual", least=0, most=10)
    rolling_s: float = param(
        "time between the exposure of the first and the last row of a picture", "s", least=0, most=0.1
    )

    def of_a_drive(self) -> dict[str, Any]:
        """Those that make a drive what it is; how many others there are does not."""
        return {name: value for name, value in asdict(self).items() if name not in SPLITS}
