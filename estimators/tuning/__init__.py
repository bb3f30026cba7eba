"""Tuning: training flights go in, the parameters of a filter that estimates best on them come out as TOML."""
