"""A workspace with stored objects of known kinds: the features of their points are word vectors and some noise."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from command import make_workspace
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.perception.labels.point_features import average_pool
from upvl_cli.perception.visual.open_vocabulary import Basis, fit
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.tables import footer_digest, write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.config import QueryConfig
from upvl_cli.query.run import query_config
from upvl_cli.stages.pca import PcaRow
from upvl_cli.stages.rows import ObjectRow
from upvl_cli.types import Ragged
from upvl_cli.vlm.mini import Mini

WORDS = (
    "car",
    "bus",
    "fire truck",
    "truck",
    "pedestrian",
    "bicycle",
    "tree",
    "road",
    "building",
    "traffic sign",
)
NOISE = 0.02
FRAME_S = 0.1


@dataclass(frozen=True)
class Thing:
    """An object, seen in each of some frames.

    Attributes:
        words: Of its points, so many each.
        x_m: How far ahead of the car.
        y_m: How far to the left of the car.
        speed_mps: Along x.
        speed_y_mps: Along y.
        track: Its number, -1 for none.
        score: Confidence.
        frames: Where it is.
        look: Word that the looks at it are along; empty for none.
    """

    words: dict[str, int]
    x_m: float = 10.0
    y_m: float = 0.0
    speed_mps: float = 0.0
    speed_y_mps: float = 0.0
    track: int = -1
    score: float = 1.0
    frames: tuple[int, ...] = field(default=(0,))
    look: str = ""


@cache
def model() -> Mini:
    return Mini()


@cache
def basis() -> Basis:
    """Fitted to what the points of all things look like."""
    rng = np.random.default_rng(0)
    return fit([_features(dict.fromkeys(WORDS, 40), rng)], model().dim)


def _features(words: dict[str, int], rng: np.random.Generator) -> np.ndarray:
    vectors = np.repeat(model().embed_text(list(words)), list(words.values()), axis=0)
    return vectors + rng.normal(0, NOISE, vectors.shape)


def _look(word: str) -> np.ndarray:
    if not word:
        return np.zeros(64, np.int8)
    return basis().quantize(basis().project(model().embed_text([word])))[0]


def rows(segment: str, things: list[Thing], frames: int) -> list[ObjectRow]:
    """One row a frame, in which the things stand in their order."""
    rng, found = np.random.default_rng(1), []
    for frame in range(frames):
        here = [thing for thing in things if frame in thing.frames]
        of_box = np.repeat(np.arange(len(here)), [sum(thing.words.values()) for thing in here])
        features = [_features(thing.words, rng) for thing in here]
        codes = basis().quantize(basis().project(np.concatenate([np.zeros((0, model().dim)), *features])))
        found.append(
            ObjectRow(
                segment,
                frame,
                center_m=np.array([[thing.x_m, thing.y_m, 0] for thing in here]).reshape(-1, 3),
                size_lwh_m=np.tile([4, 2, 1.5], (len(here), 1)),
                heading_rad=np.zeros(len(here)),
                velocity_mps=np.array([[thing.speed_mps, thing.speed_y_mps, 0] for thing in here]).reshape(
                    -1, 3
                ),
                num_points=np.bincount(of_box, minlength=len(here)) + 3,  # some that no camera sees
                score=np.array([thing.score for thing in here]),
                track_id=np.array([thing.track for thing in here], dtype=np.int64),
                time_ns=10**9 + round(frame * FRAME_S * 1e9),
                num_features=np.bincount(of_box, minlength=len(here)),
                pooled=average_pool(Ragged.grouped(of_box, codes, len(here)), basis()),
                point_feature=Ragged(codes, np.bincount(of_box, minlength=len(here))),
                num_looks=np.array([bool(thing.look) for thing in here], np.int32),
                look_feature=np.array([_look(thing.look) for thing in here], np.int8).reshape(-1, 64),
            )
        )
    return found


def workspace(
    folder: Path, drives: dict[str, list[Thing]], frames: int = 1, stage: str = "pool-features"
) -> Workspace:
    """A workspace whose store holds these things, by drive."""
    made = Workspace(PIPELINE, make_workspace(folder) / "stages", folder / "out")
    refit(made, json.dumps({"vlm": made.model_stamp}))
    for segment, things in drives.items():
        put(made, segment, things, frames, stage)
    return made


def config(made: Workspace, **values: object) -> QueryConfig:
    """The settings that ship, without a threshold, but for these values."""
    return query_config(made, {"threshold": 0.0, **values})


def refit(made: Workspace, stamp: str) -> None:
    """Write the shard of the basis."""
    kept = basis()
    fitted = PcaRow(WHOLE_DATASET, 0, kept.mean, kept.components.ravel(), kept.scale, kept.variance_kept)
    write(made.shard("pca", WHOLE_DATASET), PcaRow, [fitted], stamp=stamp, counts={})


def put(
    made: Workspace, segment: str, things: list[Thing], frames: int = 1, stage: str = "pool-features"
) -> None:
    """Write the shard of one drive."""
    stamp = json.dumps({"inputs": {"pca": footer_digest(made.shard("pca", WHOLE_DATASET))}})
    write(made.shard(stage, segment), ObjectRow, rows(segment, things, frames), stamp=stamp, counts={})
