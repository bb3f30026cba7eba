"""Errors of the shipped networks of layers, and the settings of their training."""

from argparse import Namespace
from pathlib import Path

import numpy as np
from foreign import DESCRIPTION, foreign_cell
from numpy.typing import NDArray
from pages import Part, Values, confirmed, row
from simulated import estimate_of, simulated

from estimators import create
from estimators.analysis.activity import record
from estimators.circuit.file import is_circuit
from estimators.evaluation.comparison import silenced_twin
from estimators.evaluation.flights import Flights, load_flights
from estimators.metrics import attitude_error
from estimators.networks.forward import OnLoihi, real_weights
from estimators.networks.network import NetworkEstimator, Spiking
from estimators.networks.weights_file import load_network, parameters, shipped_names
from training.config import make_config
from training.optim import LOOKAHEAD_ALPHA, LOOKAHEAD_K

Array = NDArray[np.float64]


NAME = "att-snn-paper"
"""The network that the page describes."""


def layered() -> list[str]:
    """Shipped networks of layers."""
    return [name for name in shipped_names() if not is_circuit(name)]


def without_rounding(name: str) -> NetworkEstimator:
    """A spiking network with its quantised weights, but real-valued states."""
    config, tensors = load_network(name)
    real = real_weights(config, tensors)._asdict()
    return NetworkEstimator(Spiking(config.model_copy(update={"quantised": False}), real), config.rate_hz)


def cost_of_rounding(flights: Flights) -> float:
    """What rounding the states changes of the error [°]; in floats the network has the chip's numbers."""
    chip, floats, real = (
        estimate_of(est, flights)
        for est in (create("att-snn-loihi", weights=NAME), create(NAME), without_rounding(NAME))
    )
    confirmed(f"{NAME}: estimates that differ on the emulated chip", int((chip != floats).sum()))
    rounded, unrounded = (attitude_error(each, flights.truth).mean for each in (chip, real))
    return abs(rounded - unrounded)


def result_rows(flights: Flights, data: Path) -> list[str]:
    """Errors of the shipped networks from an unknown start, at home and in RotorPy, silenced beside them."""
    rows = []
    for name in ("att-snn", "att-rnn", *layered()):
        network, twin = create(name), silenced_twin(name)
        assert twin is not None
        error, silenced = (
            attitude_error(estimate_of(est, flights), flights.truth) for est in (network, twin)
        )
        low, high = error.mean_interval()
        rotorpy = foreign_cell(name, lambda _, est=network: est, data)
        rows.append(
            row(f"`{name}`", f"{error.mean:.2f}", f"{low:.2f}–{high:.2f}", f"{silenced.mean:.2f}", rotorpy)
        )
    return rows


def weight_rows(flights: Flights) -> list[str]:
    """Size of the shipped networks, what they were trained on, and spike rates of the spiking ones."""
    rows = []
    for name in layered():
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
    hours = min(epochs * batches, training["updates"]) * config["batch_size"] * config["window_s"] / 3600
    seconds = training.get("seconds")
    spent = "–" if seconds is None else f"{seconds / 3600:.1f}"
    return str(training["training_flights"]), str(training["updates"]), f"{hours:.0f}", spent


def values(part: Part, given: Namespace) -> Values:
    """Measure."""
    flights = load_flights([simulated("test", given.data)])
    config, tensors = load_network(NAME)
    recipe = make_config("paper", data="x")
    return {
        "flights": str(len(flights.gyro)),
        "duration": f"{flights.gyro.shape[1] / flights.rate_hz:g}",
        "rotorpy": DESCRIPTION,
        "results": result_rows(flights, given.data),
        "rounding": f"{cost_of_rounding(flights):.3f}",
        "weights": weight_rows(flights),
        "encoding": str(config.encoding),
        "hidden": str(config.hidden),
        "scale": f"{config.output_scale:g}",
        "gyro": f"{config.inputs.gyro:g}",
        "accel": ", ".join(f"{each:g}" for each in config.inputs.accel),
        "offset": ", ".join(f"{each:g}" for each in config.inputs.accel_offset),
        "parameters": str(parameters(tensors)),
        "window": f"{recipe.window_s:g}",
        "batch": str(recipe.batch_size),
        "huber": f"{recipe.huber_threshold:g}",
        "rate_cost": f"{recipe.rate_cost:g}",
        "lookahead": f"{LOOKAHEAD_K}, {LOOKAHEAD_ALPHA:g}",
        "lr": f"{recipe.optimiser_lr:g}",
    }
