"""What the spiking network of training.md learnt: decoding, manipulated inputs, errors by sensor error."""

from collections.abc import Mapping
from dataclasses import replace
from textwrap import fill
from typing import NamedTuple

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import row
from simulated import estimate_of

from estimators.analysis.decoding import (
    READINGS_S,
    SPIKES_S,
    Decoding,
    Starts,
    decode,
    random_starts,
    reading_features,
    shuffled,
    spike_features,
)
from estimators.analysis.encoding_study import FAST_HZ, SLOW_HZ, responses
from estimators.evaluation.comparison import silenced_twin
from estimators.evaluation.flights import Flights, imu_of
from estimators.metrics import attitude_error
from estimators.networks.network import NetworkEstimator, OnLoihi
from estimators.networks.weights_file import load_network
from quadsim.dataset.figures import STYLE
from quadsim.estimator import AttitudeEstimator, Readings

NAME = "att-snn-loihi"
TIMES_S = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
SHOWN_S = (0.5, 2.0, 16.0)
"""Of the table; the last is the last of `TIMES_S`."""
PER_FLIGHT = 128
SOURCES = {
    "spikes": ("hidden spikes", "#33658a", "-"),
    "readings": ("readings", "#c0563b", "--"),
    "shuffled": ("shuffled network", "#777777", ":"),
}
SENSOR_PARTS = ("all", "noise", "gyroscope bias", "accelerometer bias", "perfect IMU")
SENSOR_ROWS = (NAME, "att-rnn", "mahony", "eskf", "vqf")

Array = NDArray[np.float64]


class Learnt(NamedTuple):
    """Decodings by source and quantity, and how many starts they are of."""

    decodings: dict[str, dict[str, Decoding]]
    starts: int


def learnt(dataset: xr.Dataset) -> Learnt:
    """Decode from the spikes, from the readings and from a shuffled network."""
    imu = imu_of(dataset)
    if imu is None:
        raise ValueError("the dataset does not name its IMU")
    starts = random_starts(dataset, imu, PER_FLIGHT, TIMES_S)
    found = {
        name: decode(features, starts.quantities, starts.flight) for name, features in sources(starts).items()
    }
    return Learnt(found, len(starts.flight))


def sources(starts: Starts) -> dict[str, Array]:
    """Features to decode from, by the names of `SOURCES`."""
    config, tensors = load_network("att-snn")
    return {
        "spikes": spike_features(OnLoihi(config, tensors), starts),
        "readings": reading_features(starts),
        "shuffled": spike_features(OnLoihi(config, shuffled(tensors)), starts),
    }


@matplotlib.rc_context(STYLE)
def learnt_figure(found: Learnt) -> Figure:
    """R² against the time after a start, one panel a quantity, with its interval over flights."""
    names = list(found.decodings["spikes"])
    figure = Figure(figsize=(9.6, 2.9), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(names), sharey=True), names, strict=True):
        for source, (label, colour, dash) in SOURCES.items():
            decoding = found.decodings[source][name]
            axes.fill_between(TIMES_S, *decoding.interval(), color=colour, alpha=0.15, lw=0)
            axes.plot(TIMES_S, decoding.r2, dash, color=colour, label=label, lw=1.6)
        axes.set(title=name, xscale="log", xlabel="time [s]", ylim=(-0.1, 1.0))
        axes.set_xticks([0.25, 1, 4, 16], ["¼", "1", "4", "16"])
        axes.minorticks_off()
    figure.axes[0].set_ylabel("R² on other flights")
    figure.axes[2].legend(loc="upper left")
    return figure


def learnt_parts(found: Learnt) -> dict[str, str | list[str]]:
    """The table of the decoding, and what it says."""
    rows, beyond, without_training = [], [], []
    for name, spikes in found.decodings["spikes"].items():
        readings, control = (found.decodings[source][name] for source in ("readings", "shuffled"))
        over, trained = (spikes.gain_interval(other)[:, -1] for other in (readings, control))
        beyond += [name] * bool(over[0] > 0)
        without_training += [name] * bool(trained[0] <= 0)
        at = [spikes.r2[TIMES_S.index(time)] for time in SHOWN_S]
        own, *others = (" to ".join(map(number, each)) for each in (spikes.interval()[:, -1], over, trained))
        rows.append(
            row(name, *map(number, at), own, *map(number, (readings.r2[-1], control.r2[-1])), *others)
        )
    values = ", ".join(f"{name} {number(each.r2[-1])}" for name, each in found.decodings["spikes"].items())
    text = (
        f"R² from the hidden spikes {TIMES_S[-1]:g} s after a start: {values}. It is significantly above "
        f"that from the low-passed readings for {listed(beyond)}, and not significantly above that from the "
        f"shuffled network for {listed(without_training)}."
    )
    return {
        "learnt_starts": str(found.starts),
        "spikes_s": series(SPIKES_S),
        "readings_s": series(READINGS_S),
        "learnt_times": " | ".join(f"R² at {time:g} s" for time in SHOWN_S),
        "learnt_lines": "|".join("---" for _ in SHOWN_S),
        "learnt": rows,
        "learnt_finding": fill(text, 125),
    }


def manipulated_parts(est: NetworkEstimator, flights: Flights) -> dict[str, str | list[str]]:
    """Errors and gains with one sensor changed."""
    found = responses(est, flights)
    twin = silenced_twin(NAME)
    assert twin is not None
    no_gyro, no_accel = found["gyro removed"], found["accel removed"]
    text = (
        f"Without the gyroscope the network follows attitude below {SLOW_HZ:g} Hz with a gain of "
        f"{number(no_gyro.slow_gain)} and above {FAST_HZ:g} Hz of {number(no_gyro.fast_gain)}; with "
        f"θ_acc = 0 the gains are {number(no_accel.slow_gain)} and {number(no_accel.fast_gain)}."
    )
    return {
        "silenced_deg": f"{attitude_error(estimate_of(twin, flights), flights.truth).mean:.2f}",
        "slow_hz": f"{SLOW_HZ:g}",
        "fast_hz": f"{FAST_HZ:g}",
        "manipulated": [
            row(name, *map(number, (each.error_deg, each.gain, each.slow_gain, each.fast_gain)))
            for name, each in found.items()
        ],
        "manipulated_finding": fill(text, 125),
    }


def with_sensor_errors(flights: Flights, dataset: xr.Dataset) -> dict[str, Flights]:
    """The flights with each of `SENSOR_PARTS` of their own sensor errors."""
    true, bias = (
        [dataset[name].to_numpy().astype(np.float64) for name in names]
        for names in (("ang_vel", "specific_force"), ("gyro_bias", "accel_bias"))
    )
    read = (flights.gyro, flights.accel)
    noise = [y - x - b for y, x, b in zip(read, true, bias, strict=True)]
    zero = np.zeros_like(true[0])
    errors = {
        "noise": noise,
        "gyroscope bias": (bias[0], zero),
        "accelerometer bias": (zero, bias[1]),
        "perfect IMU": (zero, zero),
    }
    return {"all": flights} | {
        name: replace(flights, readings=Readings(true[0] + gyro, true[1] + accel))
        for name, (gyro, accel) in errors.items()
    }


def sensor_parts(
    estimators: Mapping[str, AttitudeEstimator], conditions: Mapping[str, Flights], settled_s: float
) -> dict[str, str | list[str]]:
    """The error with each part of the sensor errors, and what each part does to the network."""
    rows, found = [], {}
    for name in SENSOR_ROWS:
        found[name] = [settled_rms(estimators[name], conditions[part], settled_s) for part in SENSOR_PARTS]
        twin = silenced_twin(name)
        silenced = "–" if twin is None else f"{settled_rms(twin, conditions['all'], settled_s):.2f}"
        rows.append(row(name, *(f"{each:.2f}" for each in found[name]), silenced))
    everything, *parts, clean = np.square(found[NAME])
    alone = ", ".join(
        f"{name} alone by {100 * (part - clean) / everything:+.0f} %"
        for name, part in zip(SENSOR_PARTS[1:-1], parts, strict=True)
    )
    text = (
        f"A perfect IMU leaves {percent(clean / everything)} of the mean square error of `{NAME}`. Of the "
        f"whole, it is raised from there by {alone}."
    )
    return {
        "error_parts": " | ".join(SENSOR_PARTS),
        "error_lines": "|".join("---" for _ in SENSOR_PARTS),
        "sensor_errors": rows,
        "sensor_finding": fill(text, 125),
    }


def settled_rms(est: AttitudeEstimator, flights: Flights, settled_s: float) -> float:
    """Root mean square error of roll and pitch without the first seconds [deg]."""
    error = (estimate_of(est, flights) - flights.truth)[:, round(settled_s * flights.rate_hz) :]
    return float(np.degrees(np.sqrt(np.mean(error**2))))


def percent(share: float) -> str:
    """A share as text."""
    return f"{100 * share:.0f} %"


def number(value: float) -> str:
    """Two digits, and no negative zero."""
    return f"{round(value, 2) + 0.0:.2f}"


def listed(names: list[str]) -> str:
    """Names in a sentence."""
    return ", ".join(names) or "nothing"


def series(values: tuple[float, ...]) -> str:
    """Numbers in a sentence."""
    return ", ".join(f"{each:g}" for each in values[:-1]) + f" and {values[-1]:g}"
