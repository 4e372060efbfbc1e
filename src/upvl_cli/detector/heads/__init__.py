"""Heads of the detector: ways to encode boxes at fixed anchors over the grid."""
