"""Evaluate the shipped weights: `python docs/training_page.py` writes training.md and needs data/test.zarr.

The tables that other commands made are taken from docs/training; the page says which commands.
"""

from __future__ import annotations

import csv
import math
import re
import shutil
from itertools import pairwise
from pathlib import Path
from textwrap import fill

import numpy as np
from estimators.tilt import to_roll_pitch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from scipy.signal import lfilter

from estimators import create, names, run
from estimators.activity import record
from estimators.encoder import lean_found, outputs_at, scaled_inputs
from estimators.evaluate import tilted_starts
from estimators.flights import Flights, load_flights
from estimators.metrics import attitude_error, inclination_error
from estimators.networks import NetworkEstimator, OnLoihi, Spiking, real_weights
from estimators.spiking import Weights
from estimators.symmetry import OPERATIONS, ties
from estimators.weights_file import InputScaling, Tensors, load_network, parameters, shipped_names
from quadsim.dataset import open_dataset
from quadsim.estimator import AttitudeEstimator
from training.augment import roll_pitch_of_up
from training.config import TrainConfig, make_config

HERE = Path(__file__).parent
KEPT = HERE / "training"
FILTERS = ("complementary", "madgwick", "ekf", "mahony", "vqf", "eskf", "ekf-drag")
DRAWS = 8
STARTERS = ("att-snn", "att-snn, skip connection alone", "ekf-drag", "eskf", "vqf", "mahony", "complementary")
LINEAR, IN_AXES = "best linear filter", "best linear filter, as the network's inputs"
ALONE = "att-snn's encoder, no network"
BANDS_HZ = (0.1, 1.0)
KFOLD = "--preset best --set encoding=100 --set hidden=100 --set parameters=0 --set revive=0.6 --epochs 2"
"""What Table 1 was made with."""
FOLDS = {"kfold": "as the preset", "kfold-no-lead": "no lead"}
"""Its runs: folders in runs/, and what the page calls them."""

Array = NDArray[np.float64]


def without_rounding(name: str) -> NetworkEstimator:
    """A spiking network with its quantised weights, but real-valued states."""
    config, tensors = load_network(name)
    weights, taus = real_weights(config, tensors)
    real = dict(zip(Weights._fields, [*weights, *taus], strict=True))
    return NetworkEstimator(Spiking(config.model_copy(update={"quantised": False}), real), config.rate_hz)


def without_spikes(name: str) -> NetworkEstimator:
    """What the skip connection of a spiking network says alone."""
    config, tensors = load_network(name)
    return NetworkEstimator(
        Spiking(config, tensors | {"w_out": np.zeros_like(tensors["w_out"])}), config.rate_hz
    )


def made() -> dict[str, AttitudeEstimator]:
    """Every estimator of the table."""
    found: dict[str, AttitudeEstimator] = {
        "att-snn-loihi": create("att-snn-loihi"),
        "att-snn": create("att-snn"),
        "att-snn without rounding": without_rounding("att-snn"),
        "att-snn, skip connection alone": without_spikes("att-snn"),
        "att-rnn": create("att-rnn"),
    }
    for name in shipped_names():
        if name not in found:
            config, _ = load_network(name)
            found[name] = create(config.model, weights=name)
    return found | {name: create(name) for name in FILTERS if name in names()}


def within(est: AttitudeEstimator, pieces: Flights) -> Array:
    """Time of each start until the inclination error is first below 2° [s]; infinite if it never is."""
    below = inclination_error(estimate_of(est, pieces), pieces.truth) < 2.0
    return np.where(below.any(axis=1), below.argmax(axis=1) / pieces.rate_hz, np.inf)


def many_starts(flights: Flights) -> Flights:
    """Pieces of 10 s that begin at a tilt of 20°, `DRAWS` times as many as one draw has.

    The times until an error is below a limit fall into two heaps, at once and after a swing: the median of a
    few says little.
    """
    draws = [tilted_starts(flights, 20.0, round(10 * flights.rate_hz), seed) for seed in range(DRAWS)]
    found = [draw for draw in draws if draw is not None]
    gyro, accel, quat, truth = (
        np.concatenate([getattr(draw, name) for draw in found]) for name in ("gyro", "accel", "quat", "truth")
    )
    return Flights(gyro, accel, quat, truth, flights.rate_hz)


def draw_starts(estimators: dict[str, AttitudeEstimator], pieces: Flights) -> None:
    """The median inclination error over the starts against time: writes docs/img/start.png."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes = figure.subplots()
    time = np.arange(1, pieces.gyro.shape[1] + 1) / pieces.rate_hz
    for name in STARTERS:
        error = np.median(inclination_error(estimate_of(estimators[name], pieces), pieces.truth), axis=0)
        mine = name.startswith("att-")
        axes.plot(
            time, error, label=name, linewidth=2.4 if mine else 1.2, linestyle=":" if "alone" in name else "-"
        )
    axes.axhline(2.0, color="black", linewidth=0.8, linestyle=":")
    axes.set(
        xlim=(0, 5), ylim=(0, 20), xlabel="time since the start [s]", ylabel="inclination error, median [°]"
    )
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    path = HERE / "img" / "start.png"
    figure.savefig(path, dpi=110)
    Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=64).save(path, optimize=True)


def estimate_of(est: AttitudeEstimator, flights: Flights) -> Array:
    """Roll and pitch from an unknown start."""
    return run(est, flights.gyro, flights.accel, quat=flights.quat)


def accuracy_rows(estimators: dict[str, AttitudeEstimator], flights: Flights, pieces: Flights) -> list[str]:
    """Errors with their confidence, in the order of the means."""
    rows = []
    for name, est in estimators.items():
        error = attitude_error(estimate_of(est, flights), flights.truth)
        low, high = error.mean_interval()
        time = float(np.median(within(est, pieces)))
        shown = "never" if np.isinf(time) else f"{time:.2f}"
        spread = f"{error.median:.2f} | {error.sd:.2f}"
        rows.append(
            (error.mean, f"| {name} | {error.mean:.3f} | {low:.2f}–{high:.2f} | {spread} | {shown} |")
        )
    return [row for _, row in sorted(rows)]


def weight_rows(flights: Flights) -> list[str]:
    """Spike rates of the spiking networks that ship, and how long each took."""
    rows = []
    for name in shipped_names():
        config, tensors = load_network(name)
        size = parameters(tensors)
        rates = "– | – | –"
        if config.model == "att-snn":
            activity = record(OnLoihi(config, tensors), flights.gyro[:, :10000], flights.accel[:, :10000])
            first, second = (float(activity.of_layer(activity.rates, k).mean()) for k in (0, 1))
            both = (first * config.encoding + second * config.hidden) / (config.encoding + config.hidden)
            rates = f"{first:.3f} | {second:.3f} | {both:.3f}"
        card = (HERE.parent / "assets" / "weights" / f"{name}.md").read_text()
        found = re.search(r"^\| best epoch \| (.*) \|$", card, re.MULTILINE)
        rows.append(f"| {name} | {size} | {rates} | {found[1] if found else 'see its card'} |")
    return rows


def free_parameters(tensors: Tensors) -> int:
    """Different numbers among a symmetric network's parameters: shared ones count once."""
    shared = ties(len(tensors["w_in"]), len(tensors["w_ff"]))
    there = {name: tensors[name].ravel() != 0 for name in shared}
    constants = 2 + bool(tensors["w_skip"].any())
    return constants + sum(np.unique(tied.first[there[name]]).size for name, tied in shared.items())


def untold_deg(flights: Flights) -> float:
    """Mean absolute difference of roll and pitch from the nearest outputs that turn with the body [deg]."""
    roll, pitch = flights.truth[..., 0], flights.truth[..., 1]
    up = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], -1)
    to_roll_pitch = np.array([[0, 1], [-1, 0]])
    nearest = np.zeros_like(flights.truth)
    for operation in OPERATIONS:
        back = to_roll_pitch @ operation[:2, :2].T @ to_roll_pitch.T
        nearest += roll_pitch_of_up(up @ operation.T) @ back.T / len(OPERATIONS)
    return float(np.degrees(np.abs(nearest - flights.truth).mean()))


def linear_features(inputs: InputScaling, flights: Flights) -> tuple[Array, Array]:
    """A network's inputs through first-order low-passes of ten time constants, 20 ms to 10 s.

    Returns:
        The features (n, T, 61), and cosine and sine of the axes' heading (n, T, 2).
    """
    x, heading = scaled_inputs(inputs, flights.rate_hz, flights.gyro, flights.accel)
    poles = np.exp(-1 / (flights.rate_hz * np.geomspace(0.02, 10.0, 10)))
    filtered = [lfilter([1 - pole], [1, -pole], x, axis=1) for pole in poles]
    return np.concatenate([*filtered, np.ones((*x.shape[:2], 1))], axis=-1), heading


def best_linear(inputs: InputScaling, train: Flights, flights: Flights) -> Array:
    """Roll and pitch by ridge regression on `linear_features` of the training flights."""
    x, heading = linear_features(inputs, train)
    y = outputs_at(inputs, train.truth, heading)[:, 1000::20].reshape(-1, 2)
    x = x[:, 1000::20].reshape(-1, 61)
    weights = np.linalg.solve(x.T @ x + 1e-6 * len(x) * np.eye(61), x.T @ y)
    x, heading = linear_features(inputs, flights)
    found = np.ascontiguousarray(x @ weights)
    if inputs.yaw_free:
        to_roll_pitch(found, heading)
    return found


def parts_of(error: Array, rate_hz: float) -> list[float]:
    """RMS of the constant of each flight, and of each band of frequency; errors (n, T, 2)."""
    constant = error.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(error - constant, axis=1)
    hz = np.fft.rfftfreq(error.shape[1], 1 / rate_hz)
    parts = [constant]
    for low, high in pairwise((0.0, *BANDS_HZ, np.inf)):
        parts.append(np.fft.irfft(spectrum * ((hz >= low) & (hz < high))[:, None], error.shape[1], axis=1))
    return [float(np.sqrt(np.mean(part**2))) for part in parts]


def limits(
    estimators: dict[str, AttitudeEstimator], flights: Flights, perfect: Flights, train: Flights
) -> tuple[list[str], str]:
    """The error in bands of frequency, and what they say about the spiking network."""
    rows, found, skip = [], {}, round(5 * flights.rate_hz)
    linear = {LINEAR: InputScaling(), IN_AXES: load_network("att-snn")[0].inputs}
    inputs, alone = linear[IN_AXES], (ALONE, *linear)
    for name in ("att-snn-loihi", "att-snn-spiking", "att-rnn", *alone, "mahony", "vqf", "eskf", "ekf-drag"):
        estimates = [
            lean_found(inputs, each.rate_hz, each.gyro, each.accel)
            if name == ALONE
            else best_linear(linear[name], train, each)
            if name in linear
            else estimate_of(estimators[name], each)
            for each in (flights, perfect)
        ]
        error, clean = (np.degrees(e - flights.truth)[:, skip:] for e in estimates)
        found[name] = parts_of(error, flights.rate_hz)
        found[name] += [float(np.sqrt(np.mean(each**2))) for each in (error, clean)]
        rows.append(f"| {name} | {' | '.join(f'{part:.2f}' for part in found[name])} |")
    constant, _, middle, fast, everything, clean_all = found["att-snn-loihi"]
    shares = [100 * (part / everything) ** 2 for part in (middle, fast, constant)]
    sensors = 100 * (1 - (clean_all / everything) ** 2)
    text = (
        f"Of the spiking network's mean square, {shares[0]:.0f} % lies at 0.1–1 Hz, where the attitude has "
        f"to come from the integrated rates, {shares[1]:.0f} % above 1 Hz (spikes), and {shares[2]:.0f} % is "
        f"constant (the accelerometer's bias); sensor errors of all kinds make {sensors:.0f} % of it. In "
        f"that band the best linear filter of the same readings leaves {found[LINEAR][2]:.2f}°, of the "
        f"network's inputs {found[IN_AXES][2]:.2f}°, the encoder's own lean {found[ALONE][2]:.2f}°, the GRU "
        f"{found['att-rnn'][2]:.2f}°, and VQF, which turns the vertical by the rates exactly, "
        f"{found['vqf'][2]:.2f}°."
    )
    return rows, fill(text, 125)


def kept(name: str) -> list[dict[str, str]]:
    """A table in docs/training; empty if its command has not been run."""
    path = KEPT / f"{name}.csv"
    return list(csv.DictReader(path.open())) if path.is_file() else []


def field_rows() -> list[str]:
    """Every field of a training run, with both presets' values."""
    paper, best = (make_config(preset, data="x") for preset in ("paper", "best"))
    rows = []
    for name, field in TrainConfig.model_fields.items():
        if name in ("model", "data", "validation", "preset"):
            continue
        values = [shown(getattr(config, name)) for config in (paper, best)]
        rows.append(
            f"| `{name}` | {values[0]} | {values[1]} | {' '.join((field.description or '').split())} |"
        )
    return rows


def shown(value: object) -> str:
    """A value as a table shows it; of a nested one what is set."""
    if hasattr(value, "model_dump"):
        fields = value.model_dump(exclude_defaults=True)  # type: ignore[attr-defined]  # hasattr narrows nothing
        return ", ".join(f"{k} {shown(v)}" for k, v in fields.items()) or "its defaults"
    if isinstance(value, tuple):
        return " ".join(shown(v) for v in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Measure and write the page."""
    data = open_dataset(HERE.parent / "data" / "test.zarr")
    flights = load_flights([data])
    perfect = Flights(
        data["ang_vel"].to_numpy().astype(float), data["specific_force"].to_numpy().astype(float),
        flights.quat, flights.truth, flights.rate_hz,
    )  # fmt: skip
    pieces = many_starts(flights)
    estimators = made()
    draw_starts(estimators, pieces)
    train = load_flights([open_dataset(HERE.parent / "data" / "train.zarr")], 24)
    rows, finding = limits(estimators, flights, perfect, train)
    ablation, sizes = kept("ablation"), kept("thinning")
    _, tensors = load_network("att-snn")
    means = [
        attitude_error(estimate_of(estimators[name], flights), flights.truth).mean
        for name in ("att-snn", "att-snn without rounding")
    ]
    inputs = load_network("att-snn")[0].inputs
    alone = attitude_error(lean_found(inputs, flights.rate_hz, flights.gyro, flights.accel), flights.truth)
    for name in FOLDS:
        made_now = HERE.parent / "runs" / name / "table1.csv"
        if made_now.is_file():
            shutil.copy(made_now, KEPT / f"{name}.csv")
            if name == "kfold":
                shutil.copy(made_now.with_name("kfold.png"), HERE / "img" / "kfold.png")
    parts: dict[str, str | list[str]] = {
        "kfold_options": KFOLD,
        "flights": str(len(flights.gyro)),
        "duration": f"{flights.gyro.shape[1] / flights.rate_hz:g}",
        "starts": str(len(pieces.gyro)),
        "accuracy": accuracy_rows(estimators, flights, pieces),
        "rounding": f"{abs(means[0] - means[1]):.3f}",
        "network_mean": f"{means[0]:.2f}",
        "alone_mean": f"{alone.mean:.2f}",
        "alone": ALONE,
        "weights": weight_rows(flights),
        "limits": rows,
        "finding": finding,
        "speed": [f"| {' | '.join(row.values())} |" for row in kept("speed")],
        "table1": [
            f"| {encoder} | {r['trained_on']} | {r['tested_on']} | {r['folds']} | "
            f"{float(r['mean_deg']):.2f} ± {float(r['sd_deg']):.2f} |"
            for name, encoder in FOLDS.items()
            for r in kept(name)
        ],
        "parameters": str(parameters(tensors)),
        "free": str(free_parameters(tensors)),
        "whole": str(make_config("best", data="x").whole),
        "most": str(make_config("best", data="x").parameters),
        "thin_from": f"{100 * make_config('best', data='x').thinning[0]:.0f}",
        "thin_to": f"{100 * make_config('best', data='x').thinning[1]:.0f}",
        "encoding": str(len(tensors["w_in"])),
        "hidden": str(len(tensors["w_ff"])),
        "neurons": [
            f"| {float(r['removed']):.0%} | {r['neurons']} | {r['parameters']} | "
            f"{float(r['val_error_deg']):.3f} |"
            for r in kept("neurons")
        ],
        "seed_epochs": sizes[0]["epochs"] if sizes else "?",
        "thinning": [
            f"| {r['begins']} | {r['keeps']} | {r['parameters']} | {r['neurons']} | "
            f"{float(r['val_error_deg']):.3f} | "
            f"{float(r['rate_encoding']):.3f} | {float(r['rate_hidden']):.3f} |"
            for r in sizes
        ],
        "untold": f"{untold_deg(flights):.2f}",
        "updates": ablation[0]["updates"] if ablation else "?",
        "ablation": [
            f"| {r['row']} | {float(r['val_error_deg']):.2f} | {float(r['val_settled_deg']):.2f} | "
            f"{'never' if math.isinf(float(r['within_s'])) else r['within_s']} | "
            f"{float(r['rate_encoding']):.3f} | {float(r['rate_hidden']):.3f} |"
            for r in ablation
        ],
        "fields": field_rows(),
    }
    page = (HERE / "training.template.md").read_text()
    for name, text in parts.items():
        page = page.replace(f"{{{name}}}", text if isinstance(text, str) else "\n".join(text))
    (HERE / "training.md").write_text(page)


if __name__ == "__main__":
    main()
