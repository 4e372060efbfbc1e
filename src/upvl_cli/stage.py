"""What a stage is: its settings, its rows, what it reads. Declared once; all else follows from it.

`param` and `column` give no default on purpose: a value lives in `stages/<stage>.toml` alone.
Arrow's types stand here by name, so that `upvl --help` need not load Arrow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, get_type_hints

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs


@dataclass(frozen=True)
class Param:
    """One setting of a stage: its meaning and the range that its value must keep."""

    meaning: str
    unit: str
    above: float | None
    least: float | None
    most: float | None
    choices: tuple[str, ...]

    @property
    def bounds(self) -> str:
        """The range in words, for messages, help and docs; empty where there is none."""
        parts = [
            f"> {self.above:g}" if self.above is not None else "",
            f">= {self.least:g}" if self.least is not None else "",
            f"<= {self.most:g}" if self.most is not None else "",
            f"one of {', '.join(self.choices)}" if self.choices else "",
        ]
        return " and ".join(part for part in parts if part)

    def allows(self, value: Any) -> bool:
        """Whether a value of the right type lies in the range; NaN and the infinite never do."""
        if self.choices:
            return value in self.choices
        if isinstance(value, float) and not math.isfinite(value):
            return False
        if self.above is not None and not value > self.above:
            return False
        if self.least is not None and not value >= self.least:
            return False
        return not (self.most is not None and not value <= self.most)


def param(
    meaning: str,
    unit: str = "",
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare a setting; its value stands in the stage's TOML file."""
    return field(metadata={"param": Param(meaning, unit, above, least, most, choices)})


@dataclass(frozen=True)
class Column:
    """One column of a stage's rows.

    A column without `per` and `shape` holds one number or text a frame; with `shape` one array of
    that shape; with `per` an (n, *shape) array, one item for each point, box, ... of the frame.
    """

    type: str
    meaning: str
    unit: str
    axes: str
    per: str
    shape: tuple[int, ...]

    @property
    def is_array(self) -> bool:
        """Whether the column holds an array a frame."""
        return bool(self.per or self.shape)


def column(
    type: str,
    meaning: str,
    unit: str = "",
    axes: str = "",
    *,
    per: str = "",
    shape: tuple[int, ...] = (),
) -> Any:
    """Declare a column; `type` is the name of an Arrow type such as `float16`."""
    return field(metadata={"column": Column(type, meaning, unit, axes, per, shape)})


@dataclass(frozen=True)
class Row:
    """The key that every row has."""

    segment: str = column("string", "name of the drive")
    frame: int = column("int64", "number of the frame in its segment")


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline, from declared inputs to one Parquet shard a segment.

    Attributes:
        name: Name of the command, of its TOML file and of its folder in the output.
        run: Yields the rows of one segment, in ascending order of frames.
        params: Dataclass whose fields are `param`s.
        row: Dataclass, child of `Row`, whose fields are `column`s.
        reads: Names of the stages it may open; `raw` is the drive itself, `vlm` the vision-language model.
        whole: Made once for all drives together, as one shard, and not once a segment. Where `params` has a field
            `drives`, it is made from those whose names are like one of these patterns.
        shared: Several processes of `torchrun` can make a shard together.
        large: Its shards are: `--dry-run` foretells their size.
        version: Raised by hand when the code gives other rows for equal values.
    """

    name: str
    run: Callable[[Inputs, Any], Iterator[Row]]
    params: type[Any]
    row: type[Row]
    reads: tuple[str, ...]
    whole: bool = False
    shared: bool = False
    large: bool = False
    version: int = 1

    @property
    def summary(self) -> str:
        """What the stage does: the first line of the docstring of `run`."""
        return (self.run.__doc__ or "").strip().splitlines()[0]


def params_of(settings: type[Any]) -> dict[str, tuple[type[Any], Param]]:
    """Name, Python type and declaration of each setting of a dataclass."""
    hints = get_type_hints(settings)
    return {spec.name: (hints[spec.name], spec.metadata["param"]) for spec in fields(settings)}


def columns_of(row: type[Row]) -> dict[str, Column]:
    """Name and declaration of each column of a row."""
    return {spec.name: spec.metadata["column"] for spec in fields(row)}
