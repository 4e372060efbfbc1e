"""The constants of the Waymo Open Dataset's own metrics tools; they define the scores, so no setting changes them.

Source: waymo-open-dataset 99a4cb3, metrics/tools/compute_detection_metrics_main.cc and
compute_tracking_metrics_main.cc, metrics/detection_metrics.cc. All scores, cut-offs and thresholds are float32 there.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

TYPES = ("TYPE_UNKNOWN", "TYPE_VEHICLE", "TYPE_PEDESTRIAN", "TYPE_SIGN", "TYPE_CYCLIST")
LEVELS = (1, 2)
IOU_THRESHOLDS = (0.0, 0.7, 0.5, 0.5, 0.5)  # 3D IoU of a match by type
MAX_POINTS_LEVEL_2 = 5  # a label without a level of its own is hard, level 2, up to so many points
NEAR_IOU = 0.01  # a false positive this close to a label of another speed is that speed's
SCORE_CUTOFFS = np.append(np.arange(100) * 0.01, 1.0).astype(np.float32)

Matcher = Literal["hungarian", "score_first"]
