"""Readers of recorded logs, one module for each format; each gives a `Recording` on the log's own stamps."""
