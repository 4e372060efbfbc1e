"""The pipeline that `upvl` runs: the engine, handed our stages, datasets and models."""

from __future__ import annotations

from upvl_cli.datasets.registry import dataset_family
from upvl_cli.pipeline.pipeline import Pipeline
from upvl_cli.stages import LABELLING, STAGES
from upvl_cli.vlm import model_family

PIPELINE = Pipeline(STAGES, LABELLING, dataset_family, model_family)
