"""Settings of the detector: its view, its network, its training and how boxes are read from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from upvl_cli.config.base import Config, setting, table


@dataclass(frozen=True)
class GridConfig(Config):
    """The volume that the detector sees, in ego axes with heights above the road, cut into square pillars."""

    x_min_m: float = setting("rear end of the volume that the detector sees", "m", ge=-1000, le=1000)
    x_max_m: float = setting("front end of the volume that the detector sees", "m", ge=-1000, le=1000)
    y_min_m: float = setting("right end of the volume that the detector sees", "m", ge=-1000, le=1000)
    y_max_m: float = setting("left end of the volume that the detector sees", "m", ge=-1000, le=1000)
    z_min_m: float = setting("lowest height above the road that the detector sees", "m", ge=-1000, le=1000)
    z_max_m: float = setting("largest height above the road that the detector sees", "m", ge=-1000, le=1000)
    pillar_m: float = setting("side of a pillar, the cell of the grid seen from above", "m", ge=0.02, le=10)


@dataclass(frozen=True)
class AnchorsConfig(Config):
    """The head with anchors: boxes of a few sizes and two headings at each output cell."""

    length_m: tuple[float, ...] = setting("lengths of the anchors, one a size", "m", gt=0, le=100)
    width_m: tuple[float, ...] = setting("widths of the anchors, one a size", "m", gt=0, le=100)
    height_m: tuple[float, ...] = setting("heights of the anchors, one a size", "m", gt=0, le=100)
    positive_iou: float = setting("overlap seen from above from which an anchor is positive", ge=0, le=1)
    negative_iou: float = setting(
        "overlap seen from above below which an anchor is negative; from here to positive_iou it is ignored",
        gt=0,
        le=1,
    )
    direction_weight: float = setting(
        "weight of the loss of the direction (front or rear) beside that of the angle", ge=0, le=100
    )


@dataclass(frozen=True)
class CentersConfig(Config):
    """The head without anchors: the output cell under the centre of a box predicts it."""

    length_m: float = setting("length of a box whose residual is zero", "m", gt=0, le=100)
    width_m: float = setting("width of a box whose residual is zero", "m", gt=0, le=100)
    height_m: float = setting("height of a box whose residual is zero", "m", gt=0, le=100)
    center_z_m: float = setting(
        "height above the road of the centre of a box whose residual is zero", "m", ge=-10, le=20
    )
    heatmap_sigma: float = setting(
        "standard deviation of the Gaussian around the centre of a box that lowers the weight of negative cells, "
        "in sides of the box",
        gt=0,
        le=10,
    )
    heatmap_exponent: int = setting(
        "exponent of one minus that Gaussian in the weight of a negative cell", ge=1, le=100
    )


@dataclass(frozen=True)
class ModelConfig(Config):
    """The network."""

    box_coder: Literal["anchors", "centers"] = setting(
        "how boxes are encoded; anchors: residuals beside boxes of a few sizes; centers: residuals at the cell "
        "under the centre"
    )
    width: int = setting("channels of a pillar, a multiple of 8; the network grows with it", ge=8, le=1024)
    anchors: AnchorsConfig = table("the head with anchors; used where box_coder is anchors")
    centers: CentersConfig = table("the head without anchors; used where box_coder is centers")


@dataclass(frozen=True)
class SweepsConfig(Config):
    """The two sweeps that the network takes as one cloud of points."""

    max_age_s: float = setting("age up to which the sweep before joins the current one", "s", ge=0, le=3600)
    voxel_m: float = setting(
        "side of the voxels that keep one point each of the older sweep", "m", ge=0.01, le=100
    )


@dataclass(frozen=True)
class DetectorConfig(Config):
    """What a network is built from and fed with; it is stored with the weights."""

    grid: GridConfig = table("volume that the detector sees, and its pillars")
    model: ModelConfig = table("the network")
    sweeps: SweepsConfig = table("the two sweeps that the network takes")


@dataclass(frozen=True)
class LossConfig(Config):
    """Losses of boxes."""

    focal_alpha: float = setting("weight of positives in the focal loss, alpha in RetinaNet", ge=0, le=1)
    focal_gamma: float = setting(
        "exponent that lowers the focal loss of easy places, gamma in RetinaNet", ge=0, le=10
    )
    huber_delta: float = setting(
        "residual from which the Huber loss of centres and sizes is linear", gt=0, le=100
    )
    box_weight: float = setting(
        "weight of the losses of boxes and headings beside that of objectness", ge=0, le=1000
    )


@dataclass(frozen=True)
class DistillationConfig(Config):
    """The vision-language features that points of the pictures teach (UP-VL, Section 3.4)."""

    enabled: bool = setting("true: the network also predicts features of points; false: boxes only")
    weight: float = setting("weight of the cosine distance of features in the loss", gt=0, le=1000)


@dataclass(frozen=True)
class SamplingConfig(Config):
    """Which points of a frame features are learned from."""

    features_per_frame: int = setting(
        "largest number of points of a frame whose features are learned", ge=1, le=10**7
    )
    box_share: float = setting("share of those points that is drawn from points in boxes", ge=0, le=1)


@dataclass(frozen=True)
class OptimizerConfig(Config):
    """AdamW and the schedule of its learning rate: a linear rise, then half a cosine down to 0."""

    learning_rate: float = setting("highest learning rate", ge=1e-8, le=1)
    warm_up_share: float = setting("share of the steps in which the learning rate rises", ge=0, le=1)
    weight_decay: float = setting("weight decay of AdamW", ge=0, le=1)
    max_gradient_norm: float = setting("length to which a longer gradient is cut", gt=0, le=1e6)


@dataclass(frozen=True)
class AugmentationConfig(Config):
    """How training frames are changed at random."""

    mirror_probability: float = setting("probability of a mirrored frame, left to right", ge=0, le=1)
    max_turn_rad: float = setting(
        "largest turn about the vertical axis, to either side", "rad", ge=0, le=3.15
    )
    scale_jitter: float = setting("largest change of scale, as a share, up or down", ge=0, le=0.9)
    pasted_objects: int = setting("objects of another frame that are pasted into each frame", ge=0, le=1000)


@dataclass(frozen=True)
class DecodeConfig(Config):
    """How boxes are read from the output of the network."""

    min_score: float = setting("boxes of a lower score are dropped", ge=0, le=1)
    max_boxes: int = setting(
        "largest number of boxes of a frame, those of the highest scores", ge=1, le=10_000
    )
    nms_iou: float = setting(
        "overlap seen from above over which the box of the lower score is suppressed", ge=0, le=1
    )
    candidates_per_box: int = setting(
        "highest scores that are decoded for each of max_boxes, before suppression", ge=1, le=10_000
    )


@dataclass(frozen=True)
class ShuffleConfig(Config):
    """The order of training frames, which reads few drives at a time of an archive with many."""

    chunk_frames: int = setting(
        "consecutive frames of a drive that are taken in the same window", ge=1, le=10**6
    )
    window_chunks: int = setting(
        "chunks whose frames are shuffled together; the drives of a window are read at the same time, and fewer "
        "frames than a window has are shuffled as a whole",
        ge=1,
        le=10**5,
    )


@dataclass(frozen=True)
class SelfTrainingConfig(Config):
    """Trainings one after the other; each but the first learns also from what the one before detected."""

    rounds: int = setting("number of trainings; 1 learns from the labels alone", ge=1, le=100)
    pseudo_label: DecodeConfig = table("which detections of a round are labels of the next one")


@dataclass(frozen=True)
class GroundingConfig(Config):
    """How detected boxes are put on the ground."""

    margin_m: float = setting("ground points this far beside a box count as below it", "m", ge=0, le=10)
    min_points: int = setting("a box with fewer ground points below it keeps its height", ge=1, le=10**6)


@dataclass(frozen=True)
class HandCorrectionsConfig(Config):
    """Labels that a person has corrected (`upvl import-labels`); without them no training sees human work."""

    folder: str = setting(
        "folder of hand corrections, such as out/corrections, whose drives are learned from as a person left them; "
        "empty: none is read"
    )
    weight: int = setting(
        "times that a frame of a drive with hand corrections is drawn for each time that another frame is",
        ge=1,
        le=1000,
    )


@dataclass(frozen=True)
class TrainConfig(Config):
    """Settings of `train`."""

    drives: tuple[str, ...] = setting('names of the drives to learn from, with * for anything: "train-*"')
    held_out: float = setting(
        "share of each drive, its end, that is held out to choose the weights", ge=0, le=0.9
    )
    steps: int = setting("steps of the optimizer in a training", ge=1, le=10**8)
    batch: int = setting("frames of a step, over all processes", ge=1, le=10**5)
    check_steps: int = setting(
        "steps between checks on the held-out frames; a stopped run goes on from the last check",
        ge=1,
        le=10**8,
    )
    check_frames: int = setting(
        "largest number of held-out frames of a check; of more the same ones are taken each time, spread evenly "
        "over all drives",
        ge=1,
        le=10**7,
    )
    seed: int = setting("seed of the weights, the order of frames and all random changes", ge=0, le=2**31 - 1)
    precision: Literal["half", "full"] = setting(
        "number format; half: bfloat16 where the device has units for it; full: float32, nearly the same numbers "
        "on any device"
    )
    grid: GridConfig = table("volume that the detector sees, and its pillars")
    model: ModelConfig = table("the network")
    sweeps: SweepsConfig = table("the two sweeps that the network takes")
    loss: LossConfig = table("losses of boxes")
    distillation: DistillationConfig = table("learning of vision-language features")
    sampling: SamplingConfig = table("points whose features are learned")
    optimizer: OptimizerConfig = table("AdamW and its learning rate")
    augmentation: AugmentationConfig = table("random changes of training frames")
    shuffle: ShuffleConfig = table("order of training frames")
    self_training: SelfTrainingConfig = table("trainings on detections of the training before")
    hand_corrections: HandCorrectionsConfig = table("labels that a person has corrected")

    def files(self, segment: str) -> tuple[Path, ...]:
        """Return the hand corrections of all drives."""
        folder = self.hand_corrections.folder
        return tuple(sorted(Path(folder).glob("*.parquet"))) if folder else ()

    @property
    def detector(self) -> DetectorConfig:
        """What the network is built from and fed with."""
        return DetectorConfig(self.grid, self.model, self.sweeps)
