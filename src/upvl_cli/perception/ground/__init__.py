"""Ground: the height of each point above the ground below it."""
