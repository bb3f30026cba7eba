"""Networks of layers: their errors and training, and the paper's network on the chip."""

from argparse import Namespace
from pathlib import Path

import numpy as np
import pandas as pd
from errors import on_flights, with_silenced
from pages import Part, Row, Values, confirmed, span
from simulated import PLAN, rotorpy_sets, simulated

from estimators import create, run
from estimators.analysis.ablation import error_deg
from estimators.analysis.activity import record
from estimators.analysis.energy import HOST_PICOJOULES, PAPER_MEASURED, costs, counts, host_operations
from estimators.analysis.latency import timed_estimators, update_times
from estimators.circuit.file import is_circuit
from estimators.evaluation.comparison import made_of
from estimators.evaluation.flights import Flights, load_flights
from estimators.loihi.chip import LIMITS
from estimators.metrics import Summary, attitude_error
from estimators.networks.decay_profiles import share_profiles
from estimators.networks.forward import OnLoihi, real_weights
from estimators.networks.network import NetworkEstimator, Spiking, silenced
from estimators.networks.weights_file import (
    NetworkConfig,
    Tensors,
    load_network,
    parameter_count,
    shipped_names,
)
from training.config import make_config
from training.optim import LOOKAHEAD_ALPHA, LOOKAHEAD_K

NAME = "att-snn-paper"
"""The network that the pages describe."""
PROFILES = (128, 64, 48, 32, 24)
RECIPE = ("window_s", "batch_size", "huber_threshold", "rate_cost", "optimiser_lr")
"""Settings of the training that the page shows."""
LATENCY_ROUNDS = 60
"""Turns of 100 calls."""


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
        run(est, flights.gyro, flights.accel)
        for est in (create("att-snn-loihi", weights=NAME), create(NAME), without_rounding(NAME))
    )
    confirmed(f"{NAME}: estimates that differ on the emulated chip", int((chip != floats).sum()))
    rounded, unrounded = (attitude_error(each, flights.truth).mean for each in (chip, real))
    return abs(rounded - unrounded)


def network_errors(data: Path) -> list[Row]:
    """Errors of the shipped networks from an unknown start, at home and in RotorPy, silenced beside them."""
    made = made_of(["att-snn", "att-rnn", *layered()], 200.0)
    home = on_flights(lambda _: made, [simulated("test", data)]).droplevel("initial")
    abroad = on_flights(lambda _: made, rotorpy_sets(data)).droplevel("initial")
    ends = {name: span(*Summary(home.sequences[name]).mean_interval()) for name in made}
    return [
        (f"`{name}`", each.mean_deg, ends[name], each.silenced_deg, with_silenced(abroad.loc[name]))
        for name, each in home.loc[list(made)].iterrows()
    ]


def sizes(flights: Flights) -> list[Row]:
    """Size of the shipped networks, what they were trained on, and spike rates of the spiking ones."""
    rows = []
    for name in layered():
        config, tensors = load_network(name)
        rates = ("–", "–")
        if config.model == "att-snn":
            activity = record(OnLoihi(config, tensors), flights.gyro[:, :10000], flights.accel[:, :10000])
            rates = tuple(f"{activity.of_layer(activity.rates, k).mean():.3f}" for k in (0, 1))
        training = config.training
        recipe, updates, seconds = training.get("config", {}), training["updates"], training.get("seconds")
        epochs, batches = -(-updates // recipe["batches"]), recipe["batches"]
        hours = min(epochs * batches, updates) * recipe["batch_size"] * recipe["window_s"] / 3600
        spent = "–" if seconds is None else f"{seconds / 3600:.1f}"
        neurons = f"{config.encoding} + {config.hidden}"
        flown = training["training_flights"], updates, f"{hours:.0f}", spent
        rows.append((name, neurons, parameter_count(tensors), *flown, *rates))
    return rows


def errors_and_training(part: Part, given: Namespace) -> Values:
    """Errors of the shipped networks of layers, and the settings of their training."""
    flights = load_flights([simulated("test", given.data)])
    config, tensors = load_network(NAME)
    recipe = make_config("paper", data="x")
    return {
        "flights": str(len(flights.gyro)),
        "duration": f"{flights.gyro.shape[1] / flights.rate_hz:g}",
        "rotorpy": PLAN,
        "results": network_errors(given.data),
        "rounding": f"{cost_of_rounding(flights):.3f}",
        "weights": sizes(flights),
        "encoding": str(config.encoding),
        "hidden": str(config.hidden),
        "scale": f"{config.output_scale:g}",
        "gyro": f"{config.inputs.gyro:g}",
        "accel": ", ".join(f"{each:g}" for each in config.inputs.accel),
        "offset": ", ".join(f"{each:g}" for each in config.inputs.accel_offset),
        "parameters": str(parameter_count(tensors)),
        "lookahead": f"{LOOKAHEAD_K}, {LOOKAHEAD_ALPHA:g}",
        **{key: f"{getattr(recipe, key):g}" for key in RECIPE},
    }


# --- on the chip ----------------------------------------------------------------------------------


def placed(core: OnLoihi) -> pd.DataFrame:
    """The cores of the shipped network."""
    rows = [
        (number, ", ".join(f"{k}: {len(ids)}" for k, ids in each.neurons.items()), *each.used().values())
        for number, each in enumerate(core.cores)
    ]
    limits = [f"{key} ({limit})" for key, limit in LIMITS.items()]
    return pd.DataFrame(rows, columns=["core", "neurons of layer", *limits])


def by_profiles(config: NetworkConfig, tensors: Tensors, flights: Flights) -> list[Row]:
    """What sharing decay profiles costs."""
    silent = error_deg(config, silenced(config, tensors), flights)
    shared = {"one per neuron": tensors} | {str(k): share_profiles(tensors, k) for k in PROFILES}
    return [
        (name, len(OnLoihi(config, each).cores), error_deg(config, each, flights), silent)
        for name, each in shared.items()
    ]


def latency() -> list[Row]:
    """Latency of every estimator, in turns, the shortest first."""
    taken = update_times(timed_estimators(), LATENCY_ROUNDS)
    chip = float(np.median(taken["att-snn-loihi"]))
    found = sorted((*np.percentile(each, [50, 99]), name) for name, each in taken.items())
    return [(name, middle, high, middle / chip) for middle, high, name in found]


def host_energy(config: NetworkConfig) -> list[Row]:
    """Operations of the host, with their modelled energy, and their sum."""
    counted = host_operations(config)
    counted |= {"sum": sum(counted.values())}
    both = sum(HOST_PICOJOULES.values()) / 1e3
    return [(part, count, count, count * both) for part, count in counted.items()]


def chip_energy(core: OnLoihi, flights: Flights) -> list[Row]:
    """The energy model of the chip line by line, and its sum."""
    lines = costs(counts(core.cores, record(core, flights.gyro, flights.accel)))
    rows = [
        (
            each.operation,
            f"{each.count:.1f}",
            f"{each.picojoules:g}",
            each.nanojoules,
            f"{100 * each.share:.1f} %",
        )
        for each in lines
    ]
    return [*rows, ("sum", "", "", sum(each.nanojoules for each in lines), "")]


def chip(part: Part, given: Namespace) -> Values:
    """Cores, latency, operations and energy of a network on the chip."""
    flights = load_flights([simulated("val", given.data)])
    config, tensors = load_network(NAME)
    core = OnLoihi(config, tensors)
    return {
        "cores": placed(core),
        "profiles": by_profiles(config, tensors, flights),
        "latency": latency(),
        "paper_us": f"{PAPER_MEASURED['µs']:g}",
        "flights": str(len(flights.gyro)),
        "host": host_energy(config),
        "multiplication": f"{HOST_PICOJOULES['multiplication']:g}",
        "addition": f"{HOST_PICOJOULES['addition']:g}",
        "energy": chip_energy(core, flights),
        "paper": " and ".join(f"{value:g} {unit}" for unit, value in PAPER_MEASURED.items()) + " per step",
    }
