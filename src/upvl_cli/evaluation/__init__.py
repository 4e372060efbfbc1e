"""Scores of auto labels, tracks and flow against labels: the only place that opens labels."""
