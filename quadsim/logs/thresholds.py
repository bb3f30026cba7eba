"""Thresholds that were chosen by looking at logs; `assets/logs.toml` has their meanings and units."""

import tomllib
from types import SimpleNamespace

from ..runs.fingerprint import ASSETS

CLEAN, FAULT, MOUNT, STILL, TURN, CHECK = (
    SimpleNamespace(**tomllib.loads((ASSETS / "logs.toml").read_text("utf-8"))[table])
    for table in ("cleaning", "faults", "mounting", "still", "truth", "checks")
)
"""Values of each table by name, such as `FAULT.step_s`."""
