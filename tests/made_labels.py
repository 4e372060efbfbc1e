"""Rows of labels, made by hand from the class and the length of each box."""

from __future__ import annotations

import numpy as np

from upvl_cli.stages.rows import LabelRow


def box_columns(boxes: list[tuple[str, float]]) -> dict[str, np.ndarray]:
    """What every table of boxes has, for boxes of a class and a length."""
    n = len(boxes)
    return {
        "center_m": np.arange(3.0 * n).reshape(n, 3),
        "size_lwh_m": np.array([[length, 2.0, 1.5] for _, length in boxes]).reshape(n, 3),
        "heading_rad": np.full(n, 0.25),
        "velocity_mps": np.full((n, 3), 1.0),
        "num_points": np.full(n, 7),
    }


def label_row(
    segment: str, frame: int, boxes: list[tuple[str, float]], **changed: np.ndarray | int
) -> LabelRow:
    """Labels of one frame, with other values for some columns."""
    n = len(boxes)
    columns = {
        "time_ns": frame * 10**8,
        **box_columns(boxes),
        "score": np.full(n, 0.5),
        "track_id": np.arange(n),
        "background_share": np.zeros(n),
        "num_frames_seen": np.full(n, 2),
        "objectness": np.full(n, 0.9),
        "sides_seen": np.full(n, 2),
        "residual_m": np.full(n, 0.05),
        "class_name": np.array([name for name, _ in boxes], dtype=str),
        "word": np.array(["car"] * n, dtype=str),
        "class_share": np.ones(n),
        "is_moving": np.zeros(n, bool),
        "num_looks": np.zeros(n, np.int32),
        "look_word": np.full((n, 3), "", dtype=str),
        "look_share": np.zeros((n, 3)),
        "words_agree": np.ones(n, bool),
        "iou_2d": np.full(n, -1.0),
        "box_word": np.array([""] * n, dtype=str),
        "box_share": np.zeros(n),
    }
    return LabelRow(segment, frame, **{**columns, **changed})
