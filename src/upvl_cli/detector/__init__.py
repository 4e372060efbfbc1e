"""The LiDAR-only detector: network, training on auto labels, and prediction."""
