"""What a stage is: its settings, its rows, what it reads. Declared once; all else follows from it.

Arrow's types stand here by name, so that `upvl --help` need not load Arrow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, Protocol, TypeVar

from upvl_cli.config.base import Config

if TYPE_CHECKING:
    from upvl_cli.types import Drive, Ints, Model, Points

WHOLE_DATASET = "all"  # the segment of a stage that is made once for the whole dataset
NOT_MADE = (
    "raw",
    "vlm",
)  # what a stage can read that no stage makes: the drive itself, the vision-language model


@dataclass(frozen=True)
class Column:
    """One column of a stage's rows.

    A column without `per` and `shape` holds one number or text a frame; with `shape` one array of
    that shape; with `per` an (n, *shape) array, one item for each point, box, ... of the frame.

    Attributes:
        type: Name of an Arrow type such as `float16`.
        meaning: What it holds.
        unit: Unit of its values; empty for a pure number or a text.
        axes: Axes of its values, for example "ego"; empty where it has none.
        per: What has one item of the column each; empty for one a frame.
        shape: Shape of an item.
        names: Names in the table: one in place of the field's, or one for each of the last axis of the item; empty
            where it is that of the field.
        ragged: Each item of `per` has any number of values of that shape (a `Ragged`).
    """

    type: str
    meaning: str
    unit: str
    axes: str
    per: str
    shape: tuple[int, ...]
    names: tuple[str, ...] = ()
    ragged: bool = False

    @property
    def split(self) -> tuple[str, ...]:
        """Names of the table's columns, where an item stands in several."""
        return self.names if len(self.names) > 1 else ()

    def table_names(self, field_name: str) -> tuple[str, ...]:
        """Return the names of the table's columns that hold the field of that name."""
        return self.names or (field_name,)

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
    names: tuple[str, ...] = (),
    ragged: bool = False,
) -> Any:
    """Declare a column; see `Column`."""
    shape = (len(names),) if len(names) > 1 else shape
    return field(metadata={"column": Column(type, meaning, unit, axes, per, shape, names, ragged)})


@dataclass(frozen=True)
class Row:
    """What a stage says of one frame, with the key that every table has.

    Attributes:
        per_box: Whether the table has a row for each box of the frame, or one for the frame.
    """

    per_box: ClassVar[bool] = False

    segment: str = column("string", "name of the drive")
    frame: int = column("int64", "number of the frame in its segment")


@dataclass(frozen=True)
class FrameWindow:
    """The frames of a drive from number `first` to before number `end`."""

    first: int
    end: int

    def __contains__(self, frame: int) -> bool:
        return self.first <= frame < self.end


ALL_FRAMES = FrameWindow(0, 2**63 - 1)

C = TypeVar("C", bound=Config)
R = TypeVar("R", bound=Row)
R_co = TypeVar("R_co", bound=Row, covariant=True)


class Rows(Protocol[R_co]):
    """The rows of another stage: `rows[frame]` is that of a frame."""

    @property
    def frames(self) -> tuple[int, ...]:
        """The frames that have a row, ascending."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[R_co]: ...

    def __getitem__(self, frame: int) -> R_co: ...


class Sweeps(Protocol):
    """The sweeps of one drive in any order."""

    @property
    def ground_z_m(self) -> float:
        """Height of the road below the car in ego axes, roughly."""

    def read(self, frame: int) -> Points:
        """Return the sweep of a frame."""


class Inputs(Protocol):
    """What a stage may open, and how it says what it kept and dropped."""

    @property
    def segment(self) -> str:
        """Name of the drive; `WHOLE_DATASET` for a stage that is made once."""

    @property
    def window(self) -> FrameWindow:
        """The frames to yield rows of, for a stage that is `windowed`: all of them, mostly."""

    @property
    def drive(self) -> Drive:
        """The drive itself."""

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the drives, for a stage that is made once for all of them."""

    @property
    def model(self) -> Model:
        """The vision-language model."""

    @property
    def folder(self) -> Path:
        """Folder of the stage's shards; what a stopped run goes on from can stand beside them."""

    @property
    def scratch(self) -> Path:
        """Folder on a disk of this machine with room for what waits there while the stage runs."""

    @property
    def stamp(self) -> str:
        """Stamp of the shard that is being made."""

    def drives(self) -> Iterator[Drive]:
        """Yield all drives that can be read; the others are counted."""

    def table(self, name: str, row: type[R], segment: str | None = None) -> Rows[R]:
        """Return the rows that another stage made of this segment, or of one that is named."""

    def lengths(self, name: str, segments: Sequence[str]) -> Ints:
        """Return how many frames the rows that another stage made of each of several drives have."""

    def sweeps(self, segment: str) -> Sweeps:
        """Return the sweeps of a drive, for a stage that reads each of them many times."""

    def count(self, reason: str, items: int) -> None:
        """Add to the number of items that were kept or dropped for that reason."""

    def tick(self) -> None:
        """Say that a part of a long row is done."""

    def discard_when_done(self, path: Path) -> None:
        """Name a file of `folder` that is of no use once the shard is made."""


@dataclass(frozen=True)
class Needs:
    """What one shard of a stage takes on a machine; a scheduler reserves it.

    Attributes:
        cpus: Cores that the stage keeps busy.
        gpus: GPUs, or a part of one; used where the cluster has any, as every stage runs without.
        memory_gib: Peak of main memory, GiB.
    """

    cpus: int = 1
    gpus: float = 0.0
    memory_gib: float = 2.0


@dataclass(frozen=True)
class Stage(Generic[C, R]):
    """One step of the pipeline, from declared inputs to one Parquet shard a segment.

    Attributes:
        name: Name of the command, of its TOML file and of its folder in the output.
        run: Yields the rows of one segment, in ascending order of frames.
        config: The declared settings.
        row: The declared row.
        reads: Names of the stages it may open; `raw` is the drive itself, `vlm` the vision-language model.
        scope: Made once a segment, or once for the whole dataset, as one shard. Where `config` has a setting
            `drives`, a shard of the dataset is made from those whose names are like one of these patterns.
        distributed: Several processes of `torchrun` can make a shard together.
        windowed: A frame needs no more of other frames than what their inputs hold, so that a long drive can be made
            in windows, of which each yields the rows of the frames in `Inputs.window` alone.
        estimates_size: Its shards are large: `--dry-run` estimates their size.
        version: Raised by hand when the code gives other rows for equal values.
        needs: What a scheduler reserves for one shard.
    """

    name: str
    run: Callable[[Inputs, C], Iterator[R]]
    config: type[C]
    row: type[R]
    reads: tuple[str, ...]
    scope: Literal["segment", "dataset"] = "segment"
    distributed: bool = False
    windowed: bool = False
    estimates_size: bool = False
    version: int = 1
    needs: Needs = Needs()

    @property
    def is_of_dataset(self) -> bool:
        """Whether there is one shard for the whole dataset."""
        return self.scope == "dataset"

    @property
    def has_files(self) -> bool:
        """Whether its settings can name files beside those of the drive."""
        return self.config.files is not Config.files

    @property
    def summary(self) -> str:
        """What the stage does: the first line of the docstring of `run`."""
        return (self.run.__doc__ or "").strip().splitlines()[0]


def columns_of(row: type[Row]) -> dict[str, Column]:
    """Return the name and declaration of each column of a row."""
    return {spec.name: spec.metadata["column"] for spec in fields(row)}
