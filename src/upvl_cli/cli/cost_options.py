"""The options of estimates and costs."""

from __future__ import annotations

from typing import Annotated

import typer

Estimate = Annotated[
    bool,
    typer.Option(
        "--estimate",
        help="Estimate hours, memory, bytes and cost of labelling all drives from the runs of a few; write no rules.",
    ),
]
Drives = Annotated[
    int | None,
    typer.Option(min=1, help="Number of drives to estimate for; those of the workspace when left out."),
]
SampleSize = Annotated[
    int,
    typer.Option(
        "--sample",
        min=2,
        help="Smallest number of labelled drives that an estimate is made from; all are used.",
    ),
]
EstimateWorkers = Annotated[
    int,
    typer.Option(
        min=1, help="Number of workers that work at once, for the estimated time from start to end."
    ),
]
CpuPrice = Annotated[
    float | None, typer.Option("--price-cpu-hour", min=0, help="Price of an hour of one processor core.")
]
GpuPrice = Annotated[
    float | None, typer.Option("--price-gpu-hour", min=0, help="Price of an hour of one GPU.")
]
StoragePrice = Annotated[
    float | None,
    typer.Option("--price-tb-month", min=0, help="Price of storing a terabyte (1e12 bytes) for a month."),
]
