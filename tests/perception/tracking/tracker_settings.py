"""Settings of the tracker that its tests share."""

from upvl_cli.perception.tracking.config import TrackerConfig, TravelConfig

CONFIG = TrackerConfig(
    acceleration_psd_m2ps3=2.0,
    position_noise_m=0.2,
    center_noise_share=0.1,
    velocity_noise_mps=0.7,
    gate_sigma=4.0,
    max_coast_s=0.5,
    max_gap_s=1.5,
    max_standing_gap_s=4.0,
    standing_mps=0.5,
    standing_psd_m2ps3=0.02,
    max_overlap_s=0.5,
    min_boxes=4,
    window_s=30.0,
    min_seconds=0.5,
    min_coast_frames=1,
    min_gap_frames=2,
    travel=TravelConfig(required=True, min_distance_m=1.0, min_path_slope=0.5),
)
