"""Tuning: search for the parameters of a filter with the smallest error on training flights."""
