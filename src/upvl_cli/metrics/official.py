"""The settings of the Waymo Open Dataset's own metrics tools, as facts to compare by.

Source: waymo-open-dataset 99a4cb3, metrics/tools/compute_detection_metrics_main.cc and
compute_tracking_metrics_main.cc. All scores, cut-offs and thresholds are float32 there.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

TYPES = ("TYPE_UNKNOWN", "TYPE_VEHICLE", "TYPE_PEDESTRIAN", "TYPE_SIGN", "TYPE_CYCLIST")
LEVELS = (1, 2)
IOU_THRESHOLDS = (0.0, 0.7, 0.5, 0.5, 0.5)  # by type
SCORE_CUTOFFS = np.append(np.arange(100) * 0.01, 1.0).astype(np.float32)

Matcher = Literal["hungarian", "score_first"]
