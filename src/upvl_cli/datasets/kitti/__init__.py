"""KITTI raw drives, read in place."""
