"""Registration of upright objects: rotation about the vertical and translation."""
