"""Reproduction of the paper: its tables and figures, with quadsim's results and a verdict on each claim."""
