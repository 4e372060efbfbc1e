"""From pixels to points: projection, features, words (UP-VL, section 3.2)."""
