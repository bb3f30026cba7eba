"""Readers, one a format: each maps a format's names and units to those of `quadsim.logs.recording`."""

import importlib
from typing import Any


def needed(package: str, extra: str) -> Any:
    """A package of an extra.

    Raises:
        ValueError: It is not installed; one line that says how to get it.
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        name = package.split(".")[0]
        raise ValueError(f'this log needs the package {name}: pip install "quadsim[{extra}]"') from error
