"""What the sensors of a drive cannot give, in plain sentences; and how the sensors of several drives differ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from upvl_cli.perception.sensor.card import SensorCard
from upvl_cli.perception.sensor.config import SensorConfig

_SPEED_MPS = 10.0  # of a car in a town
_SCALE_RATIO = 10.0  # intensities this much larger are on another scale
_FAR_M = 100.0  # nobody labels beyond
_LEVEL_DEG = 6.0  # around the horizon
_OTHER_SHARE = 0.25  # of the points or the rate


def limits(card: SensorCard, config: SensorConfig) -> tuple[str, ...]:
    """Return what a user should not expect from labels of a drive with these sensors.

    Args:
        card: The sensors.
        config: Settings.
    """
    return (*_rate_limits(card, config), *_beam_limits(card, config))


def _rate_limits(card: SensorCard, config: SensorConfig) -> Iterator[str]:
    if card.rate_hz is None:
        yield "one frame: nothing is seen to move, and no object has a track"
    elif card.rate_hz < config.min_rate_hz:
        yield (
            f"{card.rate_hz:.1f} Hz: at {_SPEED_MPS:g} m/s an object moves {_SPEED_MPS / card.rate_hz:.1f} m from "
            "sweep to sweep, more than a car's length: velocities of fast objects are guesses, and their tracks break"
        )
    elif card.rate_hz > config.max_rate_hz:
        yield (
            f"{card.rate_hz:.1f} Hz: at {_SPEED_MPS:g} m/s an object moves {100 * _SPEED_MPS / card.rate_hz:.0f} cm "
            "from sweep to sweep, near the noise of ranges: slow objects seem to stand; give each second or third sweep"
        )


def _beam_limits(card: SensorCard, config: SensorConfig) -> Iterator[str]:
    lidar = card.main_lidar
    if lidar is None:
        yield "no point at all: nothing can be labelled"
        return
    reach_m = person_reach_m(card, config)
    if reach_m is not None and reach_m < _FAR_M:
        yield (
            f"{len(lidar.beams_deg)} beams, {lidar.beam_step_deg:.1f} degrees apart: pedestrians beyond "
            f"{reach_m:.0f} m get fewer than {config.person_points} points"
        )
    if lidar.field_of_view_deg < 360:
        yield (
            f"the LiDAR sees {lidar.field_of_view_deg:.0f} degrees around {lidar.direction_deg:.0f}: nothing is "
            "labelled elsewhere"
        )


def person_reach_m(card: SensorCard, config: SensorConfig) -> float | None:
    """Return the distance from which on a pedestrian has too few points; None where the beams cannot be told.

    Args:
        card: The sensors.
        config: Settings.
    """
    lidar = card.main_lidar
    if lidar is None or lidar.beam_step_deg is None or lidar.azimuth_step_deg is None:
        return None
    beams = np.array(lidar.beams_deg)
    level = beams[np.abs(beams) < _LEVEL_DEG]  # people far away are seen there
    gap_deg = float(np.median(np.diff(level))) if len(level) > 2 else lidar.beam_step_deg
    # A person at distance r spans height / (r gap) beams and width / (r step) columns, on average.
    area_m2 = config.person_width_m * config.person_height_m / config.person_points
    return float(np.sqrt(area_m2 / (np.radians(gap_deg) * np.radians(lidar.azimuth_step_deg))))


def differences(cards: Mapping[str, SensorCard]) -> tuple[str, ...]:
    """Return how the sensors of drives differ from those of most, a sentence for each drive and difference.

    Args:
        cards: The sensors of each drive, by its name.
    """
    return tuple(sentence for name in sorted(cards) for sentence in _differences(name, cards))


def _differences(name: str, cards: Mapping[str, SensorCard]) -> Iterator[str]:
    lidar = cards[name].main_lidar
    others = [card for other, card in cards.items() if other != name]
    lidars = [card.main_lidar for card in others if card.main_lidar is not None]
    if lidar is None or not lidars:
        return
    highest = [other.intensity.highest for other in lidars]
    usual = float(np.median(highest))
    if usual > 0 and lidar.intensity.highest > _SCALE_RATIO * usual:
        yield f"{name}: intensities reach {lidar.intensity.highest:.3g}, those of other drives {usual:.3g}"
    elif lidar.intensity.highest == 0 < min(highest):
        yield f"{name}: has no intensities, other drives have some"
    counts = {len(other.beams_deg) for other in lidars if other.beams_deg}
    if lidar.beams_deg and len(counts) == 1 and len(lidar.beams_deg) not in counts:
        yield f"{name}: {len(lidar.beams_deg)} beams, other drives have {counts.pop()}"
    rates = [card.rate_hz for card in others if card.rate_hz is not None]
    rate = cards[name].rate_hz
    if rate is None or not rates:
        return
    usual_hz = float(np.quantile(rates, 0.5, method="higher"))
    if abs(rate / usual_hz - 1) > _OTHER_SHARE:
        yield f"{name}: {rate:.1f} sweeps a second, other drives have {usual_hz:.1f}"
