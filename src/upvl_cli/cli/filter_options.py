"""The options that choose boxes by motion, place, time and score: the same in every command that has them."""

from __future__ import annotations

from typing import Annotated

import typer

Moving = Annotated[
    bool | None,
    typer.Option(
        "--moving/--parked",
        help="Take only moving or only parked objects; moving is a speed of at least moving_mps of query.toml.",
    ),
]
MinSpeed = Annotated[
    float | None, typer.Option(help="Minimum horizontal speed of an object over the ground (m/s).")
]
MaxSpeed = Annotated[
    float | None, typer.Option(help="Maximum horizontal speed of an object over the ground (m/s).")
]
MaxRange = Annotated[
    float | None, typer.Option(help="Maximum horizontal distance of an object from the car (m).")
]
FromS = Annotated[
    float | None, typer.Option("--from", help="Earliest time after the first frame of a drive (s).")
]
ToS = Annotated[float | None, typer.Option("--to", help="Latest time after the first frame of a drive (s).")]
MinScore = Annotated[float | None, typer.Option(help="Minimum confidence of a box itself, from 0 to 1.")]
