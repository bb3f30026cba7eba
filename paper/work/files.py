"""Files of a stage's folder."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from quadsim.runs.files import write_whole

FLIGHTS, WEIGHTS, TUNING, NUMBERS = "flights.zarr", "best.safetensors", "tuned.toml", "numbers.json"
Inputs = Mapping[str, Path]
"""Stage to its folder."""
Names = Sequence[str]


def write_numbers(folder: Path, numbers: Mapping[str, Any]) -> None:
    """Write the numbers of a stage."""
    write_whole(folder / NUMBERS, json.dumps(numbers))
