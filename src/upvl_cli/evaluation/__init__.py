"""Evaluation of auto labels, detections, tracks and flow against human labels: the only room that opens those."""
