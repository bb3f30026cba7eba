"""Stages that analyse a network: spikes, ablation, operations, and manipulated inputs."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from estimators.analysis.ablation import error_deg, pruned, without
from estimators.analysis.activity import record
from estimators.analysis.energy import costs, counts, gru_flops, snn_flops
from estimators.analysis.manipulation import responses
from estimators.networks.forward import OnLoihi
from estimators.networks.network import NetworkEstimator, Spiking
from estimators.networks.weights_file import load_network
from quadsim.dataset.reading import open_dataset

from ..stages import FLIGHTS, WEIGHTS, Numbers
from .scores import stage_flights

FRACTIONS = tuple(np.round(np.arange(0.0, 0.65, 0.05), 2))
"""Shares of the neurons that the ablation curves remove."""
RARE = 0.005
"""Spikes per step below which the paper removes a neuron."""


def inspect_network(folder: Path, *, flights: Path, network: Path, twin: Path) -> Numbers:
    """Measure spikes, ablation, modelled energy and operations of a network on the chip (Figs. 7, 9)."""
    config, tensors = load_network(network / WEIGHTS)
    recorded = stage_flights(flights)
    core = OnLoihi(config, tensors)
    activity = record(core, recorded.gyro, recorded.accel)
    rates = [activity.of_layer(activity.rates, layer) for layer in (0, 1)]
    left = without(config, tensors, [np.flatnonzero(rate >= RARE) for rate in rates])
    rng = np.random.default_rng(0)
    values = {"activity": rates, "random": [rng.random(rate.size) for rate in rates]}
    curves = {
        by: [error_deg(*pruned(config, tensors, each, fraction), recorded) for fraction in FRACTIONS]
        for by, each in values.items()
    }
    gru, _ = load_network(twin / WEIGHTS)
    spikes = float(rates[0].sum()), float(rates[1].sum())
    flops = snn_flops(config.encoding, config.hidden, spikes, config.n_outputs)
    return {
        "rates": [rate.round(5).tolist() for rate in rates],
        "without_rare": {
            "error_deg": error_deg(*left, recorded),
            "neurons": left[0].encoding + left[0].hidden,
        },
        "fractions": FRACTIONS,
        "ablation": curves,
        "costs": [asdict(each) for each in costs(counts(core.cores, activity))],
        "flops": flops | {"gru": gru_flops(gru.encoding, gru.hidden, gru.n_outputs)},
    }


def manipulate(folder: Path, *, cruise: Path, test: Path, networks: Sequence[Path]) -> Numbers:
    """Measure the response to manipulated inputs: pitch in a cruise, gains in aggressive flight (Fig. 8)."""
    found = {}
    for network in networks:
        config, tensors = load_network(network / WEIGHTS)
        est = NetworkEstimator(Spiking(config, tensors), config.rate_hz)
        steady, fast = (responses(est, stage_flights(each)) for each in (cruise, test))
        found[network.name] = {
            way: {
                "pitch_deg": np.degrees(steady[way].estimate[::SHOWN, 1]).round(2).tolist(),
                "cruise_deg": steady[way].error_deg,
                "error_deg": each.error_deg,
                "slow_gain": each.slow_gain,
                "fast_gain": each.fast_gain,
            }
            for way, each in fast.items()
        }
    truth = stage_flights(cruise)
    pitch = np.degrees(truth.truth[0, ::SHOWN, 1]).round(2).tolist()
    flown = open_dataset(cruise / FLIGHTS)["velocity"].to_numpy()
    metres_s = float(np.median(np.linalg.norm(flown, axis=-1)))
    return {"networks": found, "pitch_deg": pitch, "step_s": SHOWN / truth.rate_hz, "metres_s": metres_s}


SHOWN = 8
"""Decimation factor of the drawn responses."""
