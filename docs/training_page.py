"""Evaluate the shipped weights: `python docs/training_page.py [--data FOLDER]` writes training.md."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from textwrap import fill

import numpy as np
from foreign import DESCRIPTION, foreign_cell
from learnt import learnt, learnt_figure, learnt_parts, manipulated_parts, sensor_parts, with_sensor_errors
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import confirmed, load_page, row
from scipy.signal import lfilter
from simulated import estimate_of, options, simulated

from estimators import create, names
from estimators.analysis.activity import record
from estimators.appearance import End, label_ends, look
from estimators.evaluation.comparison import made_of, silenced_twin, tilted_starts
from estimators.evaluation.flights import Flights, load_flights
from estimators.metrics import attitude_error, inclination_error, up_in_body
from estimators.networks.encoder import scaled_inputs
from estimators.networks.network import NetworkEstimator, OnLoihi, Spiking, real_weights
from estimators.networks.symmetry import OPERATIONS, is_symmetric, weight_sharing
from estimators.networks.weights_file import InputScaling, Tensors, load_network, parameters, shipped_names
from estimators.registry import FILTERPY, NETWORKS
from quadsim.estimator import AttitudeEstimator, Readings
from quadsim.rotation import roll_pitch_of_up
from training.config import TrainConfig, make_config

VEHICLE, RATE_HZ = "hummingbird", 200.0
LEFT_OUT = ("truth", "att-snn", *FILTERPY)
"""The truth has no error, att-snn is att-snn-loihi in floats, and filterpy's filters are ekf and slow."""
DRAWS = 8
STARTERS = ("att-snn-loihi", "att-rnn", "ekf-drag", "eskf", "vqf", "mahony", "complementary")
SHOWN_S = 5.0
"""Time after a start that is drawn [s]."""
LINEAR = "best linear filter"
BANDS_HZ = (0.1, 1.0)
BANDED = ("att-snn-loihi", "att-rnn", "mahony", "eskf", "vqf", "ekf-drag")
SETTLED_S = 5.0

Array = NDArray[np.float64]


def made() -> dict[str, AttitudeEstimator]:
    """Every estimator of the results."""
    found = made_of([name for name in names() if name not in LEFT_OUT], RATE_HZ, vehicle=VEHICLE)
    for name in shipped_names():
        if name not in NETWORKS:
            found[name] = create(load_network(name)[0].model, weights=name)
    return found


def without_rounding(name: str) -> NetworkEstimator:
    """A spiking network with its quantised weights, but real-valued states."""
    config, tensors = load_network(name)
    real = real_weights(config, tensors)._asdict()
    return NetworkEstimator(Spiking(config.model_copy(update={"quantised": False}), real), config.rate_hz)


def cost_of_rounding(flights: Flights) -> float:
    """What rounding the states of `att-snn` changes of its error [°]; in floats it has the chip's numbers."""
    chip, floats, real = (
        estimate_of(est, flights)
        for est in (create("att-snn-loihi"), create("att-snn"), without_rounding("att-snn"))
    )
    confirmed("att-snn: estimates that differ from those of att-snn-loihi", int((chip != floats).sum()))
    rounded, unrounded = (attitude_error(each, flights.truth).mean for each in (chip, real))
    return abs(rounded - unrounded)


def within(est: AttitudeEstimator, pieces: Flights) -> Array:
    """Time of each start until the inclination error is first below 2° [s]; infinite if it never is."""
    below = inclination_error(estimate_of(est, pieces), pieces.truth) < 2.0
    return np.where(below.any(axis=1), below.argmax(axis=1) / pieces.rate_hz, np.inf)


def many_starts(flights: Flights) -> Flights:
    """Pieces of 10 s that begin at a tilt of 20°, from `DRAWS` draws of the places."""
    draws = [tilted_starts(flights, 20.0, round(10 * flights.rate_hz), seed) for seed in range(DRAWS)]
    found = [draw for draw in draws if draw is not None]
    gyro, accel, quat, truth = (
        np.concatenate([getattr(draw, name) for draw in found]) for name in ("gyro", "accel", "quat", "truth")
    )
    return Flights(Readings(gyro, accel), quat, truth, flights.rate_hz)


def start_figure(estimators: dict[str, AttitudeEstimator], pieces: Flights) -> Figure:
    """The median inclination error over the starts against time."""
    time = np.arange(1, pieces.gyro.shape[1] + 1) / pieces.rate_hz
    return drawn_starts(
        time,
        {
            name: np.median(inclination_error(estimate_of(estimators[name], pieces), pieces.truth), axis=0)
            for name in STARTERS
        },
    )


def drawn_starts(time: NDArray[np.float64], errors: dict[str, NDArray[np.float64]]) -> Figure:
    """Errors (T,) [deg] of estimators against time (T,) [s] in its first seconds; networks in bold."""
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    axes = figure.subplots()
    axes.axhline(2.0, color="black", linewidth=0.8, linestyle=":")
    axes.set(xlim=(0, SHOWN_S), ylim=(1, 22), yscale="log")
    axes.set(xlabel="time since the start [s]", ylabel="inclination error, median [°]")
    axes.set_yticks([1, 2, 3, 5, 10, 20], ["1", "2", "3", "5", "10", "20"])
    axes.minorticks_off()
    ends = []
    for name, error in errors.items():
        axes.plot(time, error, lw=2.6 if name in NETWORKS else 1.5, **look(name).line)
        ends.append(End(float(error[time <= SHOWN_S][-1]), name, look(name).colour))
    label_ends(axes, ends, size=10)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.3)
    return figure


def rotorpy_cell(name: str, est: AttitudeEstimator, data: Path) -> str:
    """The error on RotorPy's flights from an unknown start; ekf-drag has the constants of each airframe."""
    if name == "ekf-drag":
        return foreign_cell(name, lambda vehicle: create(name, RATE_HZ, vehicle=vehicle), data)
    return foreign_cell(name, lambda _: est, data)


def result_rows(
    estimators: dict[str, AttitudeEstimator], flights: Flights, pieces: Flights, data: Path
) -> list[str]:
    """Errors from unknown and known starts and in RotorPy, and the time from 20° to 2°; best first."""
    rows = []
    for name, est in estimators.items():
        error = attitude_error(estimate_of(est, flights), flights.truth)
        low, high = error.mean_interval()
        twin = silenced_twin(name)
        if twin is None:
            silenced = "–"
            known = f"{attitude_error(estimate_of(est, flights.known()), flights.known().truth).mean:.2f}"
        else:
            silenced, known = f"{attitude_error(estimate_of(twin, flights), flights.truth).mean:.2f}", "–"
        time = float(np.median(within(est, pieces)))
        shown = "never" if np.isinf(time) else f"{time:.2f}"
        rotorpy = rotorpy_cell(name, est, data)
        cells = (name, f"{error.mean:.2f}", f"{low:.2f}–{high:.2f}", silenced, known, rotorpy, shown)
        rows.append((error.mean, row(*cells)))
    return [text for _, text in sorted(rows)]


def weight_rows(flights: Flights) -> list[str]:
    """Size of the shipped networks, what they were trained on, and spike rates of the spiking ones."""
    rows = []
    for name in shipped_names():
        config, tensors = load_network(name)
        rates = ("–", "–")
        if config.model == "att-snn":
            activity = record(OnLoihi(config, tensors), flights.gyro[:, :10000], flights.accel[:, :10000])
            rates = tuple(f"{activity.of_layer(activity.rates, k).mean():.3f}" for k in (0, 1))
        neurons = f"{config.encoding} + {config.hidden}"
        rows.append(row(name, neurons, parameters(tensors), *training_cells(config.training), *rates))
    return rows


def training_cells(training: dict) -> tuple[str, ...]:
    """Flights, updates, hours of flight in all updates, and hours that the last run took."""
    config = training.get("config", {})
    epochs, batches = -(-training["updates"] // config["batches"]), config["batches"]
    plan = TrainConfig(**config) if config.get("later_windows") else None
    lengths = [plan.window_s_in(k) if plan else config["window_s"] for k in range(epochs)]
    hours = min(epochs * batches, training["updates"]) / epochs * config["batch_size"] * sum(lengths) / 3600
    seconds = training.get("seconds")
    spent = "–" if seconds is None else f"{seconds / 3600:.1f}"
    return str(training["training_flights"]), str(training["updates"]), f"{hours:.0f}", spent


def free_parameters(tensors: Tensors) -> int:
    """Different numbers among a symmetric network's parameters: shared ones count once."""
    shared = weight_sharing(*(len(tensors[name]) for name in ("w_in", "w_ff", "w_out")))
    there = {name: tensors[name].ravel() != 0 for name in shared if name in tensors}
    return 2 + sum(np.unique(shared[name].first[used]).size for name, used in there.items())


def symmetry_text(tensors: Tensors, flights: Flights) -> str:
    """What weight sharing leaves free, and what it costs at large tilts."""
    if not is_symmetric(tensors):
        return "The shipped `att-snn` was trained without it."
    text = f"Of the {parameters(tensors)} parameters of `att-snn` {free_parameters(tensors)} are free."
    if len(tensors["w_out"]) == 3:
        return text
    text += (
        " Roll and pitch turn with the body for small tilts only: the nearest outputs that do turn with it "
        f"are {asymmetry_deg(flights):.2f}° from the truth in the mean over the test flights."
    )
    return fill(text, 125)


def asymmetry_deg(flights: Flights) -> float:
    """Mean absolute difference of roll and pitch from the nearest outputs that turn with the body [deg]."""
    up = up_in_body(flights.truth)
    to_roll_pitch = np.array([[0, 1], [-1, 0]])
    nearest = np.zeros_like(flights.truth)
    for operation in OPERATIONS:
        back = to_roll_pitch @ operation[:2, :2].T @ to_roll_pitch.T
        nearest += roll_pitch_of_up(up @ operation.T) @ back.T / len(OPERATIONS)
    return float(np.degrees(np.abs(nearest - flights.truth).mean()))


def linear_features(flights: Flights) -> Array:
    """The readings through first-order low-passes of ten time constants, 20 ms to 10 s, and 1: (n, T, 61)."""
    x = scaled_inputs(InputScaling(), flights.gyro, flights.accel)
    poles = np.exp(-1 / (flights.rate_hz * np.geomspace(0.02, 10.0, 10)))
    filtered = [lfilter([1 - pole], [1, -pole], x, axis=1) for pole in poles]
    return np.concatenate([*filtered, np.ones((*x.shape[:2], 1))], axis=-1)


def linear_weights(train: Flights) -> Array:
    """Ridge regression of roll and pitch on `linear_features`, (61, 2)."""
    x = linear_features(train)[:, 1000::20].reshape(-1, 61)
    y = train.truth[:, 1000::20].reshape(-1, 2)
    return np.linalg.solve(x.T @ x + 1e-6 * len(x) * np.eye(61), x.T @ y)


def parts_of(error: Array, rate_hz: float) -> list[float]:
    """RMS of the constant of each flight, and of each band of frequency; errors (n, T, 2)."""
    constant = error.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(error - constant, axis=1)
    hz = np.fft.rfftfreq(error.shape[1], 1 / rate_hz)
    parts = [constant]
    for low, high in pairwise((0.0, *BANDS_HZ, np.inf)):
        parts.append(np.fft.irfft(spectrum * ((hz >= low) & (hz < high))[:, None], error.shape[1], axis=1))
    return [rms(part) for part in parts]


def rms(error: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(error**2)))


def band_rows(
    estimators: dict[str, AttitudeEstimator], flights: Flights, perfect: Flights, linear: Array
) -> tuple[list[str], str]:
    """The error in bands of frequency, and where that of the spiking network lies."""
    rows, found, skip = [], {}, round(SETTLED_S * flights.rate_hz)
    for name in (*BANDED, LINEAR):
        estimates = [
            linear_features(each) @ linear if name == LINEAR else estimate_of(estimators[name], each)
            for each in (flights, perfect)
        ]
        error, clean = (np.degrees(estimate - flights.truth)[:, skip:] for estimate in estimates)
        found[name] = [*parts_of(error, flights.rate_hz), rms(error), rms(clean)]
        twin = silenced_twin(name)
        silenced = "–"
        if twin is not None:
            silenced = f"{rms(np.degrees(estimate_of(twin, flights) - flights.truth)[:, skip:]):.2f}"
        parts = [f"{part:.2f}" for part in found[name]]
        rows.append(row(name, *parts[:-1], silenced, parts[-1]))
    constant, slow, middle, fast, everything, clean_all = found["att-snn-loihi"]
    shares = [100 * (part / everything) ** 2 for part in (constant, slow, middle, fast)]
    text = (
        f"Of the mean square error of `att-snn-loihi`, {shares[0]:.0f} % is constant over a flight, "
        f"{shares[1]:.0f} % lies below {BANDS_HZ[0]:g} Hz, {shares[2]:.0f} % in the middle band "
        f"and {shares[3]:.0f} % above it. A perfect IMU changes the error by "
        f"{100 * (clean_all / everything - 1):+.0f} %. In the middle band the best linear "
        f"filter of the same readings has an error of {found[LINEAR][2]:.2f}°, the network of {middle:.2f}°, "
        f"VQF of {found['vqf'][2]:.2f}°."
    )
    return rows, fill(text, 125)


def field_rows() -> list[str]:
    """Every field of a training run, with both presets' values."""
    paper, best = (make_config(preset, data="x") for preset in ("paper", "best"))
    rows = []
    for name, field in TrainConfig.model_fields.items():
        if name in ("model", "data", "validation", "preset"):
            continue
        values = [shown(getattr(config, name)) for config in (paper, best)]
        rows.append(row(f"`{name}`", *values, " ".join((field.description or "").split())))
    return rows


def shown(value: object) -> str:
    """A value as a table shows it; of a nested one what is set."""
    if hasattr(value, "model_dump"):
        fields = value.model_dump(exclude_defaults=True)  # type: ignore[attr-defined]  # hasattr narrows nothing
        return ", ".join(f"{k} {shown(v)}" for k, v in fields.items()) or "its defaults"
    if isinstance(value, tuple):
        return " ".join(shown(v) for v in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write the page."""
    given = options(__doc__, arguments)
    page = load_page("training")
    data = simulated("test", given.data)
    flights = load_flights([data])
    conditions = with_sensor_errors(flights, data)
    pieces = many_starts(flights)
    estimators = made()
    page.save(start_figure(estimators, pieces), "start.png", dpi=110, colours=64)
    train = load_flights([simulated("train", given.data)], 24)
    bands, finding = band_rows(estimators, flights, conditions["perfect IMU"], linear_weights(train))
    found = learnt(data)
    page.save(learnt_figure(found), "learnt.png", dpi=110, colours=64)
    network = estimators["att-snn-loihi"]
    assert isinstance(network, NetworkEstimator)
    config, tensors = load_network("att-snn")
    best = make_config("best", data="x")
    page.write(
        {
            "flights": str(len(flights.gyro)),
            "duration": f"{flights.gyro.shape[1] / flights.rate_hz:g}",
            "starts": str(len(pieces.gyro)),
            "rotorpy": DESCRIPTION,
            "results": result_rows(estimators, flights, pieces, given.data),
            "rounding": f"{cost_of_rounding(flights):.3f}",
            "weights": weight_rows(flights),
            "settled": f"{SETTLED_S:g}",
            "bands": bands,
            "finding": finding,
            **sensor_parts(estimators, conditions, SETTLED_S),
            **learnt_parts(found),
            **manipulated_parts(network, flights),
            "encoding": str(config.encoding),
            "hidden": str(config.hidden),
            "scale": f"{config.output_scale:g}",
            "gyro": f"{config.inputs.gyro:g}",
            "accel": ", ".join(f"{each:g}" for each in config.inputs.accel),
            "offset": ", ".join(f"{each:g}" for each in config.inputs.accel_offset),
            "symmetry": symmetry_text(tensors, flights),
            "window": f"{best.window_s:g}",
            "batch": str(best.batch_size),
            "huber": f"{best.huber_threshold:g}",
            "rate_cost": f"{best.rate_cost:g}",
            "rate_targets": shown(best.rate_targets),
            "lookahead": f"{best.lookahead_k}, {best.lookahead_alpha:g}",
            "lr": f"{best.optimiser_lr:g}",
            "fields": field_rows(),
        }
    )


if __name__ == "__main__":
    main()
