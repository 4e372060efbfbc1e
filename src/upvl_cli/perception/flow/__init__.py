"""Scene flow: the motion of each point between two sweeps (MI-UP, section 4.1)."""
