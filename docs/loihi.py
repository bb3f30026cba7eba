"""The page loihi.md: everything about the chip."""

import tempfile
from argparse import Namespace
from pathlib import Path

import matplotlib
import numpy as np
from pages import Page, Parts, reduce_colours, row
from simulated import simulated

from estimators.analysis.ablation import error_deg
from estimators.analysis.energy import HOST_PICOJOULES, PAPER_MEASURED, host_costs
from estimators.analysis.inspection import FRACTIONS, Inspection, inspect, load_spiking, write_page
from estimators.analysis.inspection_figures import ablation_curve
from estimators.analysis.latency import PAPER_US, contenders, measure
from estimators.evaluation.flights import Flights, load_flights
from estimators.loihi.chip import LIMITS
from estimators.networks.decay_profiles import share_profiles
from estimators.networks.network import OnLoihi, silenced
from estimators.networks.weights_file import Tensors, shipped_network
from quadsim.dataset.figures import STYLE

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
    config, _ = shipped_network("att-snn")
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
    lines = host_costs(found.config)
    sums = [
        sum(getattr(each, name) for each in lines) for name in ("multiplications", "additions", "nanojoules")
    ]
    rows = [row(each.part, each.multiplications, each.additions, f"{each.nanojoules:.2f}") for each in lines]
    return [*rows, row("sum", *sums[:2], f"{sums[2]:.2f}")]


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
    others = ("error", "removed", "modelled")
    return [row(key, text) for key, text in found.summary() if not key.startswith(others)]


def values(page: Page, given: Namespace) -> Parts:
    """Measure everything, and draw."""
    flights = load_flights([simulated("val", given.data)])
    name, config, tensors = load_spiking()
    found = inspect(name, config, tensors, flights)
    silenced_deg = f"{error_deg(config, silenced(config, tensors), flights):.2f}"
    with tempfile.TemporaryDirectory() as folder:
        write_page(folder, found)
        for picture in ("rates", "raster", "membranes", "inputs", "tuning"):
            path = page.root / "docs" / "img" / f"loihi-{picture}.png"
            path.write_bytes((Path(folder) / f"{picture}.png").read_bytes())
            reduce_colours(path, 64)
    with matplotlib.rc_context(STYLE):
        page.save(ablation_curve(FRACTIONS, found.ablation), "loihi-ablation.png", colours=64)
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
