"""Benchmark tasks that others can enter: data, runs of an entry, and result files."""
