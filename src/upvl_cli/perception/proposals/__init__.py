"""Boxes of single sweeps (UP-VL, Algorithm 1, line 6)."""
