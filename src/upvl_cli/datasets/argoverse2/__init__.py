"""Argoverse 2: Feather logs of two LiDARs and nine cameras, and the height of the ground."""
