"""The pipeline that `upvl` runs: the engine, handed our stages, datasets and models."""

from __future__ import annotations

from typing import TYPE_CHECKING

from upvl_cli.config.corrections import CorrectionsConfig
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.pipeline.pipeline import Pipeline
from upvl_cli.stages import LABELLING, STAGES
from upvl_cli.vlm import model_family

if TYPE_CHECKING:
    from upvl_cli.types import Drive


def _correct(drive: Drive, config: CorrectionsConfig) -> Drive:
    from upvl_cli.perception.corrected_drive import correct  # loads NumPy, which `upvl --help` does without

    return correct(drive, config)


PIPELINE = Pipeline(STAGES, LABELLING, dataset_family, model_family, _correct)
