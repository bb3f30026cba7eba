"""Trajectories: set-points (n, steps) from kinds of manoeuvres in TOML files."""
