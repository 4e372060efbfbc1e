"""What the engine is handed: stages, datasets and models. It knows none of them by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from upvl_cli.config.base import Config
from upvl_cli.config.corrections import CorrectionsConfig
from upvl_cli.pipeline.stage import Stage

if TYPE_CHECKING:
    from upvl_cli.types import Dataset, Drive, Model

AnyStage = Stage[Any, Any]


class DatasetAdapter(Protocol):
    """How one kind of dataset is opened."""

    @property
    def config(self) -> type[Config] | None:
        """Settings of its own, in `stages/<name>.toml`; None where the folder is all it needs."""

    @property
    def open(self) -> Callable[[Path, Any], Dataset]:
        """Open the folder that `raw.toml` names, with the settings of its own."""


class ModelAdapter(Protocol):
    """How one family of vision-language models is opened."""

    @property
    def version(self) -> int:
        """Raised by hand when the code gives other features for equal weights."""

    @property
    def files(self) -> Callable[[str], tuple[Path, ...]]:
        """From what follows the colon of `model` in `vlm.toml`, the files whose content makes the model."""

    @property
    def open(self) -> Callable[[str], Model]:
        """Open the model, from the same text; its network is loaded when it is needed."""


@dataclass(frozen=True)
class Pipeline:
    """Stages in the order in which they run, and where their drives and their model come from.

    Attributes:
        stages: Each after those that it reads.
        labelling: Names of the stages that make labels; the others learn from labels.
        dataset: The adapter of a name in `raw.toml`; raises `BadSetting` for an unknown one.
        model: The adapter and the weights of a value in `vlm.toml`; raises `BadSetting` for an unknown one.
        correct: The drive with the corrections of `raw.toml`; raises `BadSetting` for one that makes no sense.
    """

    stages: tuple[AnyStage, ...]
    labelling: tuple[str, ...]
    dataset: Callable[[str], DatasetAdapter]
    model: Callable[[str], tuple[ModelAdapter, str]]
    correct: Callable[[Drive, CorrectionsConfig], Drive]

    @cached_property
    def by_name(self) -> Mapping[str, AnyStage]:
        """The stages by their names."""
        return {stage.name: stage for stage in self.stages}

    @property
    def labelling_stages(self) -> tuple[AnyStage, ...]:
        """The stages that make labels, in order."""
        return tuple(stage for stage in self.stages if stage.name in self.labelling)

    @property
    def later_stages(self) -> tuple[AnyStage, ...]:
        """The stages that learn from labels, in order."""
        return tuple(stage for stage in self.stages if stage.name not in self.labelling)
