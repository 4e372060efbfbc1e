"""Labels and predictions put in order of frames, and the pairs of them that overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.boxes import geometry_of
from upvl_cli.geometry.iou import iou_3d
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.types import Array, Bools, Ints, ParallelArrays, array, concat, empty


@dataclass(frozen=True)
class Edges(ParallelArrays):
    """Pairs that overlap: prediction and label by number, and their 3D IoU as float32.

    Ordered by frame, then prediction, then label.
    """

    prediction: Array = array("int64")
    truth: Array = array("int64")
    iou: Array = array("float32")


@dataclass(frozen=True)
class Pairing:
    """Labels and predictions sorted by segment and frame; in a frame they keep their order.

    Attributes:
        truth: The labels.
        predictions: The predictions.
        truth_frame: (n,) number of the frame of each label, counted over all segments.
        prediction_frame: (m,) the same for each prediction.
        sequence: (f,) number of the segment of each frame.
        prediction_row: (m,) where each prediction stood before.
        truth_row: (n,) where each label stood before.
        starts: (f + 1, 3) where the predictions, labels and overlaps of each frame begin.
        edges: Every overlapping pair of one frame and one type.
    """

    truth: Truth
    predictions: Predictions
    truth_frame: Ints
    prediction_frame: Ints
    sequence: Ints
    prediction_row: Ints
    truth_row: Ints
    starts: Ints
    edges: Edges

    def predictions_of(self, frame: int) -> slice:
        """Return where the predictions of a frame stand."""
        return self._part(frame, 0)

    def labels_of(self, frame: int) -> slice:
        """Return where the labels of a frame stand."""
        return self._part(frame, 1)

    def edges_of(self, frame: int) -> slice:
        """Return where the overlaps of a frame stand."""
        return self._part(frame, 2)

    def _part(self, frame: int, column: int) -> slice:
        return slice(int(self.starts[frame, column]), int(self.starts[frame + 1, column]))


def pair_frames(truth: Truth, predictions: Predictions) -> Pairing:
    """Return labels and predictions in order of frames, with their overlaps.

    Args:
        truth: Labels of any number of segments.
        predictions: Predictions of the same ones.
    """
    _, sequence = np.unique(np.concatenate([truth.sequence, predictions.sequence]), return_inverse=True)
    moments = np.column_stack([sequence, np.concatenate([truth.frame, predictions.frame])])
    frames, frame = np.unique(moments, axis=0, return_inverse=True)
    of_truth, of_prediction = np.split(frame.reshape(-1), [len(truth)])
    truth_row = np.argsort(of_truth, kind="stable")
    prediction_row = np.argsort(of_prediction, kind="stable")
    truth, predictions = truth[truth_row], predictions[prediction_row]
    truth_frame, prediction_frame = of_truth[truth_row], of_prediction[prediction_row]
    counts = np.arange(len(frames) + 1)
    starts = [np.searchsorted(number, counts) for number in (prediction_frame, truth_frame)]
    edges = _overlaps(truth, predictions, *starts)
    starts.append(np.searchsorted(prediction_frame[edges.prediction], counts))
    return Pairing(
        truth,
        predictions,
        truth_frame,
        prediction_frame,
        frames[:, 0],
        prediction_row,
        truth_row,
        np.column_stack(starts),
        edges,
    )


def _overlaps(truth: Truth, predictions: Predictions, starts_p: Ints, starts_t: Ints) -> Edges:
    found = [empty(Edges)]
    predicted_boxes, true_boxes = geometry_of(predictions), geometry_of(truth)
    for p, p_end, t, t_end in zip(starts_p, starts_p[1:], starts_t, starts_t[1:], strict=False):
        iou = iou_3d(predicted_boxes[p:p_end], true_boxes[t:t_end]).astype(np.float32)
        iou[predictions.type[p:p_end, None] != truth.type[t:t_end]] = 0  # other types never match
        row, column = np.nonzero(iou)
        found.append(Edges(p + row, t + column, iou[row, column]))
    return concat(found, Edges)


def can_match(pairing: Pairing, iou_thresholds: Array) -> Bools:
    """Return (e,) whether each overlap reaches the threshold of its type, both as float32.

    Args:
        pairing: The overlaps.
        iou_thresholds: (5,) minimum IoU of a match by type.
    """
    kind = pairing.predictions.type[pairing.edges.prediction]
    threshold = np.asarray(iou_thresholds, dtype=np.float32)
    return np.asarray((pairing.edges.iou >= threshold[kind]) & (kind > 0))  # an unknown type has no threshold
