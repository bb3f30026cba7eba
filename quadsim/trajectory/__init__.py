"""Trajectories: a kind of manoeuvre from TOML goes in, an array of set-points (n, steps, 11) comes out."""
