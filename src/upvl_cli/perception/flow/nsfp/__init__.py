"""Flow by small coordinate networks that are optimised for one pair of sweeps: NSFP and NSFP++."""
