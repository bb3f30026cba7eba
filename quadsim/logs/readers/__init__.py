"""Readers, one a format: each maps a format's names and units to those of `quadsim.logs.recording`."""
