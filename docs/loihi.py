"""The page loihi.md: everything about the chip."""

from argparse import Namespace

import numpy as np
from pages import Page, Parts, row
from simulated import simulated

from estimators.analysis.ablation import error_deg
from estimators.analysis.energy import HOST_PICOJOULES, PAPER_MEASURED, host_operations
from estimators.analysis.inspection import (
    FRACTIONS,
    Inspection,
    ablation_figure,
    inspect,
    raster_figure,
    tuning_figure,
)
from estimators.analysis.latency import PAPER_US, contenders, measure
from estimators.evaluation.flights import Flights, load_flights
from estimators.loihi.chip import LIMITS
from estimators.networks.decay_profiles import share_profiles
from estimators.networks.forward import OnLoihi
from estimators.networks.network import silenced
from estimators.networks.weights_file import Tensors, load_network

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


def host_rows(found: Inspection) -> list[str]:
    """Operations of the host, with their modelled energy, and their sum."""
    counted = host_operations(found.config)
    counted |= {"sum": sum(counted.values())}
    both = sum(HOST_PICOJOULES.values()) / 1e3
    return [row(part, count, count, f"{count * both:.2f}") for part, count in counted.items()]


def energy_rows(found: Inspection) -> list[str]:
    """The energy model of the chip line by line, and its sum."""
    rows = [
        row(
            each.operation, f"{each.count:.1f}", f"{each.picojoules:g}", f"{each.nanojoules:.2f}",
            f"{each.share:.1%}",
        )
        for each in found.costs
    ]  # fmt: skip
    return [*rows, row("sum", "", "", f"{sum(each.nanojoules for each in found.costs):.2f}", "")]


def summary_rows(found: Inspection) -> list[str]:
    """The terminal's summary, without what other tables of the page show."""
    return [row(key, text) for key, text in found.summary() if "layer" in key or "neurons follow" in key]


def values(page: Page, given: Namespace) -> Parts:
    """Measure everything, and draw."""
    flights = load_flights([simulated("val", given.data)])
    config, tensors = load_network(NAME)
    found = inspect(config, tensors, flights)
    silenced_deg = f"{error_deg(config, silenced(config, tensors), flights):.2f}"
    page.save(raster_figure(found.activity, found.truth, config.rate_hz), "loihi-raster.png", colours=64)
    page.save(tuning_figure(found.activity, found.tuning), "loihi-tuning.png", colours=64)
    page.save(ablation_figure(FRACTIONS, found.ablation), "loihi-ablation.png", colours=64)
    return {
        "cores": core_rows(found.core),
        "limits": " | ".join(f"{key} ({limit})" for key, limit in LIMITS.items()),
        "limit_lines": "|".join("---" for _ in LIMITS),
        "profiles": profile_rows(tensors, flights, silenced_deg),
        "latency": latency_rows(),
        "paper_us": f"{next(iter(PAPER_US.values())):g}",
        "flights": str(len(flights.gyro)),
        "host": host_rows(found),
        "multiplication": f"{HOST_PICOJOULES['multiplication']:g}",
        "addition": f"{HOST_PICOJOULES['addition']:g}",
        "energy": energy_rows(found),
        "paper": " and ".join(f"{value:g} {unit}" for unit, value in PAPER_MEASURED.items()) + " a step",
        "summary": summary_rows(found),
        "inputs": [
            row(key, f"{each.error_deg:.2f}", silenced_deg, f"{each.gain:.2f}")
            for key, each in found.responses.items()
        ],
    }
