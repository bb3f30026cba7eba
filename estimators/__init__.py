"""Attitude estimators: everything that runs at inference."""

from .protocol import create, names, parameters, run, run_batch

__all__ = ["create", "names", "parameters", "run", "run_batch"]
