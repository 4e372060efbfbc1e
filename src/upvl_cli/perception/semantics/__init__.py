"""The class of every point of a drive, by words."""
