"""Boxes of one object over time (UP-VL, Algorithm 1, line 7)."""
