"""Odometry: poses of the car from its sweeps."""
