"""The LiDAR-only detector: its network, what it learns from, and what it says of a frame."""
