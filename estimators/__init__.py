"""Attitude estimators: filters and networks, with their evaluation, tuning and export."""

from .checking import check_estimator
from .filters.parameter import Parameter
from .registry import create, names, parameters
from .running import run, run_batch

__all__ = ["Parameter", "check_estimator", "create", "names", "parameters", "run", "run_batch"]
