"""Light and air: what makes two drives along the same street look different."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.types import Array

OVERCAST = 0.9  # with more clouds than this no shadow is seen


@dataclass(frozen=True)
class Weather:
    """Light and air.

    Attributes:
        sun: (3,) direction to the sun, of length 1.
        sun_share: Brightness that comes from it rather than from the whole sky, 0 to 1.
        sky_rgb: (2, 3) colour of the sky at the horizon and overhead.
        visibility_m: Distance at which haze leaves 1 / e of a thing's own colour.
        exposure: Brightness of the pictures, about 1.
        warmth: Factor on red, and one over that on blue.
        noise: Noise of the pictures, of the full brightness.
    """

    sun: Array
    sun_share: float
    sky_rgb: Array
    visibility_m: float
    exposure: float
    warmth: float
    noise: float


def weather(rng: np.random.Generator, *, light: float, haze: float) -> Weather:
    """Return the weather of a drive by chance: clear to overcast, morning to evening, now and then hazy.

    Args:
        rng: Source of all chance.
        light: Factor on how much clouds, exposure and colour vary; 0 is a clear day.
        haze: Factor on how thick the haze may get.
    """
    cloudy = min(light * float(rng.beta(0.8, 1.0)), 1.0)
    height, azimuth = float(rng.uniform(0.35, 1.2)), float(rng.uniform(0, 2 * np.pi))
    sun = np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)])
    clear = np.array([[196.0, 214.0, 232.0], [92.0, 142.0, 208.0]])
    grey = np.array([[204.0, 208.0, 212.0], [168.0, 174.0, 182.0]])
    return Weather(
        sun=sun,
        sun_share=0.62 * (1 - cloudy) if cloudy < OVERCAST else 0.0,
        sky_rgb=clear + cloudy * (grey - clear),
        visibility_m=float(np.exp(rng.uniform(np.log(250), np.log(2500)))) / max(haze, 1e-3),
        exposure=float(np.exp(light * rng.uniform(-0.16, 0.18))),
        warmth=float(1 + light * (0.12 * (1.2 - height) * (1 - cloudy) + rng.normal(0, 0.02))),
        noise=float(rng.uniform(0.004, 0.016)),
    )
