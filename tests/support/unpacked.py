"""Flights in time as the report unpacks them."""

import base64

import numpy as np

from scenarios.bench.flight_series import MISSING


def unpack_series(series):
    """Every channel and signal of a flight, each (T,), NaN where missing, and its `time` [s]."""
    found = {}
    for name, channel in series.channels.items():
        integers = np.frombuffer(base64.b64decode(channel.data), "<i2")
        found[name] = np.where(integers == MISSING, np.nan, channel.scale * integers.astype(np.float64))
    return found | {"time": series.dt * np.arange(len(found["x"]), dtype=np.float64)}
