"""A stage that opens pictures: which, and what their parts say of whole tracks."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from memory_inputs import SEGMENT, MemoryDrive, MemoryInputs, amodal_row

from upvl_cli.perception.labels.config import LookChoiceConfig, LookCropConfig
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.perception.visual.views import NO_VIEW, OCCLUDED, SEEN
from upvl_cli.stages import looks
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.rows import MaskRow, OdometryRow
from upvl_cli.types import Boxes, Camera, Image

# x ahead, y left, z up; the camera looks ahead.
AHEAD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
CAMERA = Camera(
    "front", 200, 100, np.array([[100.0, 0, 99.5], [0, 100, 49.5], [0, 0, 1]]), np.zeros(5), AHEAD
)
CONFIG = looks.LooksConfig(
    choice=LookChoiceConfig(looks_per_track=1, min_gap_s=0.1, min_px=5),
    crop=LookCropConfig(context=0.2, max_px=64, wanted_px=0),
)
RED, GREEN = [250, 0, 0], [0, 250, 0]


class Colours:
    """A model whose features are colours."""

    def embed_image(self, rgb: np.ndarray) -> np.ndarray:
        features = np.full((*rgb.shape[:2], COMPONENTS), 1e-6, np.float32)
        features[..., :3] += rgb
        return features


@dataclass
class PictureDrive(MemoryDrive):
    """Sweeps with one camera, whose pictures are counted."""

    pictures: dict[int, np.ndarray] = field(default_factory=dict)
    opened: Counter[int] = field(default_factory=Counter)

    def image(self, frame: int, camera: str) -> Image | None:
        self.opened[frame] += 1
        rgb = self.pictures.get(frame)
        return None if rgb is None else Image(rgb, frame * 10**8)


def picture(*colours: list[int]) -> np.ndarray:
    """Two halves."""
    rgb = np.zeros((100, 200, 3), np.uint8)
    rgb[:, :100], rgb[:, 100:] = colours
    return rgb


def street(states: list[list[int]], pictures: dict[int, np.ndarray]) -> MemoryInputs:
    """Two tracks, 7 on the left and 8 on the right, of three points each; they come nearer from frame to frame."""
    drive = PictureDrive({}, (CAMERA,), pictures)
    tables: dict[str, list] = {"odometry": [], "extract-vl": [], "mask": [], "nms": []}
    identity = np.eye(COMPONENTS, dtype=np.float32)
    basis = Basis(np.zeros(COMPONENTS, np.float32), identity, np.full(COMPONENTS, 0.01, np.float32), 1.0)
    tables["pca"] = [PcaRow("all", 0, basis.mean, basis.components.ravel(), basis.scale, 1.0)]
    for frame, state in enumerate(states):
        x_m = 12.0 - 2 * frame
        boxes = Boxes.from_rows(np.array([[x_m, 3, 0, 2, 2, 2, 0], [x_m, -3, 0, 2, 2, 2, 0]]))
        drive.xyz_ego_m[frame] = np.repeat(boxes.center_m, 3, axis=0) + np.tile(
            [[0, 0.2, 0], [0, 0, 0], [0, 0, 0.3]], (2, 1)
        )
        seen = np.array(state, np.int8)
        tables["odometry"].append(
            OdometryRow(SEGMENT, frame, frame * 10**8, np.eye(4), True, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
        )
        tables["extract-vl"].append(
            ExtractVlRow(
                SEGMENT,
                frame,
                seen,
                np.where(seen == SEEN, 0, -1).astype(np.int8),
                np.zeros(((seen == SEEN).sum(), COMPONENTS), np.int8),
            )  # fmt: skip
        )
        tables["mask"].append(MaskRow(SEGMENT, frame, np.zeros(6, bool), np.zeros(6, np.int8)))
        tables["nms"].append(amodal_row(frame, boxes, [7, 8]))
    return MemoryInputs(tables, drive, Colours())


ALL = [SEEN] * 6
LEFT_HIDDEN = [OCCLUDED, OCCLUDED, SEEN, SEEN, SEEN, SEEN]


def features(inputs: MemoryInputs) -> list[list[list[int]]]:
    return [row.look_feature[:, :2].tolist() for row in looks.run(inputs, CONFIG)]


def test_all_labels_of_a_track_have_the_feature_of_its_best_picture() -> None:
    # Frame 2 is nearest, but most of track 7 is occluded there: its best picture is that of frame 1.
    inputs = street([ALL, ALL, LEFT_HIDDEN], {1: picture(RED, RED), 2: picture(GREEN, GREEN)})
    assert features(inputs) == [[[100, 0], [0, 100]]] * 3
    assert inputs.drive.opened == {1: 1, 2: 1}
    assert inputs.counts["looks"] == 2
    assert inputs.counts["labels of tracks with looks"] == 6


def test_each_object_has_the_feature_of_its_own_place_in_the_picture() -> None:
    inputs = street([ALL], {0: picture(RED, GREEN)})
    assert features(inputs) == [[[100, 0], [0, 100]]]
    assert inputs.drive.opened == {0: 1}  # once for both


def test_without_a_picture_or_a_view_there_is_no_look() -> None:
    missing = street([ALL, ALL], {})
    for row in looks.run(missing, CONFIG):
        assert row.num_looks.tolist() == [0, 0]
        assert not row.look_feature.any()
    blind = street([[NO_VIEW] * 6], {0: picture(RED, GREEN)})
    (row,) = looks.run(blind, CONFIG)
    assert row.num_looks.tolist() == [0, 0]
    assert not blind.drive.opened


def test_points_that_are_background_do_not_belong_to_the_object() -> None:
    inputs = street([ALL], {0: picture(RED, GREEN)})
    inputs.tables["mask"][0].background[:3] = 1
    (row,) = looks.run(inputs, CONFIG)
    assert row.num_looks.tolist() == [0, 1]
