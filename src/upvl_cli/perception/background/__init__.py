"""Which points are background, also where no camera sees (UP-VL, Algorithm 1, line 5)."""
