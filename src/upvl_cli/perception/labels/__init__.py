"""Scores, names and features of labels."""
