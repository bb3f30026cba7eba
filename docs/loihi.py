"""Cores, latency, operations and energy of a network on the chip."""

from argparse import Namespace

import numpy as np
from pages import Part, Values, row
from simulated import simulated

from estimators.analysis.ablation import error_deg
from estimators.analysis.activity import record
from estimators.analysis.energy import HOST_PICOJOULES, PAPER_MEASURED, costs, counts, host_operations
from estimators.analysis.latency import contenders, measure
from estimators.evaluation.flights import Flights, load_flights
from estimators.loihi.chip import LIMITS
from estimators.networks.decay_profiles import share_profiles
from estimators.networks.forward import OnLoihi
from estimators.networks.network import silenced
from estimators.networks.weights_file import NetworkConfig, Tensors, load_network

NAME = "att-snn-paper"
"""The network that the page describes."""
PROFILES = (128, 64, 48, 32, 24)
LATENCY_ROUNDS = 60
"""Turns of 100 calls."""


def core_rows(core: OnLoihi) -> list[str]:
    """The cores of the shipped network."""
    return [
        row(number, ", ".join(f"{k}: {len(ids)}" for k, ids in each.neurons.items()), *each.used().values())
        for number, each in enumerate(core.cores)
    ]


def profile_rows(tensors: Tensors, flights: Flights, silenced_deg: str) -> list[str]:
    """What sharing decay profiles costs."""
    config, _ = load_network(NAME)
    shared = {"one a neuron": tensors} | {str(k): share_profiles(tensors, k) for k in PROFILES}
    return [
        row(name, len(OnLoihi(config, each).cores), f"{error_deg(config, each, flights):.2f}", silenced_deg)
        for name, each in shared.items()
    ]


def latency_rows() -> list[str]:
    """Latency of every estimator, in turns."""
    taken = measure(contenders(), LATENCY_ROUNDS)
    chip = float(np.median(taken["att-snn-loihi"]))
    found = sorted((*np.percentile(each, [50, 99]), name) for name, each in taken.items())
    return [row(name, f"{middle:.2f}", f"{high:.2f}", f"{middle / chip:.2f}") for middle, high, name in found]


def host_rows(config: NetworkConfig) -> list[str]:
    """Operations of the host, with their modelled energy, and their sum."""
    counted = host_operations(config)
    counted |= {"sum": sum(counted.values())}
    both = sum(HOST_PICOJOULES.values()) / 1e3
    return [row(part, count, count, f"{count * both:.2f}") for part, count in counted.items()]


def energy_rows(core: OnLoihi, flights: Flights) -> list[str]:
    """The energy model of the chip line by line, and its sum."""
    lines = costs(counts(core, record(core, flights.gyro, flights.accel)))
    rows = [
        row(
            each.operation, f"{each.count:.1f}", f"{each.picojoules:g}", f"{each.nanojoules:.2f}",
            f"{each.share:.1%}",
        )
        for each in lines
    ]  # fmt: skip
    return [*rows, row("sum", "", "", f"{sum(each.nanojoules for each in lines):.2f}", "")]


def values(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    flights = load_flights([simulated("val", given.data)])
    config, tensors = load_network(NAME)
    core = OnLoihi(config, tensors)
    silenced_deg = f"{error_deg(config, silenced(config, tensors), flights):.2f}"
    return {
        "cores": core_rows(core),
        "limits": " | ".join(f"{key} ({limit})" for key, limit in LIMITS.items()),
        "limit_lines": "|".join("---" for _ in LIMITS),
        "profiles": profile_rows(tensors, flights, silenced_deg),
        "latency": latency_rows(),
        "paper_us": f"{PAPER_MEASURED['µs']:g}",
        "flights": str(len(flights.gyro)),
        "host": host_rows(config),
        "multiplication": f"{HOST_PICOJOULES['multiplication']:g}",
        "addition": f"{HOST_PICOJOULES['addition']:g}",
        "energy": energy_rows(core, flights),
        "paper": " and ".join(f"{value:g} {unit}" for unit, value in PAPER_MEASURED.items()) + " a step",
    }
