"""Settings of registration; imports nothing heavy, so that `upvl --help` stays quick."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class YawIcpConfig(Config):
    """Settings of one ICP about the vertical."""

    radius_m: float = setting(
        "correspondence radius: pairs of points further apart are left out", "m", ge=0.01, le=20
    )
    max_iterations: int = setting("steps of ICP at most", ge=1, le=10000)
    tolerance_m: float = setting(
        "ICP has converged once a step moves no point further than this", "m", gt=0, le=1
    )


@dataclass(frozen=True)
class RegistrationConfig(YawIcpConfig):
    """Settings of registration from several starts: ICP, the grid of starts, and which result is accepted."""

    start_offsets: tuple[float, ...] = setting(
        "shifts of the grid of starts in x and in y, as shares of the target's extent", ge=-2, le=2
    )
    sufficient_inlier_share: float = setting(
        "share of inliers from which the starts at the guesses suffice and the grid is not tried", ge=0, le=1
    )
    min_inlier_share: float = setting(
        "share of a cloud's points with a partner within the radius below which its registration is rejected",
        ge=0,
        le=1,
    )
    max_yaw_rad: float = setting("rotation beyond which a registration is rejected", "rad", ge=0, le=3.1416)
