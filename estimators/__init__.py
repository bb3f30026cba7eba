"""Attitude estimators: everything that runs at inference."""

from .registry import create, names, parameters
from .running import run, run_batch

__all__ = ["create", "names", "parameters", "run", "run_batch"]
