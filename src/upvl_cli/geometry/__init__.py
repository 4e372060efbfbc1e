"""Geometry of rigid motions, boxes and cameras: arrays in, arrays out."""
