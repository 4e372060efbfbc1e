"""What a drive's sensors are, measured from its sweeps: beams, turn, height, what they see and what limits follow."""
