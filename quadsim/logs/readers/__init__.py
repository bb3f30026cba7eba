"""Readers of log formats, which convert names and units to those of `quadsim.logs.recording`."""
