"""Metrics, arrays in and numbers out: Waymo's boxes and tracks, Argoverse 2's flow, and an analysis of errors."""
