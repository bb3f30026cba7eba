"""Networks from other tools on the emulated chip: agreement with floats, cores, energy, latency, C99."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from quadsim.config.ranges import Between
from quadsim.config.toml import Strict
from quadsim.runs.files import write_whole

from ..export.chip_network import ChipNetwork, Peaks, quantise
from ..export.layers_c import write_layers_c
from ..export.nir_layers import FloatLayer, layers_of, read_graph
from ..loihi.chip import partition
from ..loihi.layers import LoihiNetwork
from ..loihi.neurons import VTH_EXP, VTH_MAX
from ..networks.encoder import INPUT_MAX, INPUT_ONE
from ..networks.forward import BIAS_EXP, advance_encoders
from ..networks.weights_file import ordered
from .activity import Activity
from .energy import costs, counts

Array = NDArray[np.float64]
DT = Between(1e-9, 10.0, "s")
RANDOM_RATE = 0.1
"""Mean number of random spikes per input and step."""


class ImportSettings(Strict):
    """How a network is imported, as set by `--set`."""

    dt: Annotated[float, DT] | None = None
    """Time step, in the unit of the time constants in the file [s]; None: the step in its metadata."""
    input: str | None = None
    """A .npy file with an array (T, inputs) or (n, T, inputs); None: random spikes."""
    steps: Annotated[int, Between(10, 20000)] = 1000
    """Number of steps of random spikes."""


def import_nir(
    source: str | Path, out: str | Path, settings: ImportSettings, seed: int = 0
) -> dict[str, Any]:
    """Convert the network of a NIR file for the emulated chip, run it, and write the results to a folder.

    The folder contains the integers (`network.safetensors`: the arguments of each `LoihiLayer`, prefixed by
    the number of the layer), C99 (`network.c`, `network.h`, `main.c`) and `report.json`.

    Args:
        source: The file.
        out: The folder. It must not exist.
        settings: Step and input.
        seed: Seed of random spikes.

    Returns:
        The report.

    Raises:
        FileNotFoundError: The file or the input does not exist.
        ValueError: The file, a node or the input is invalid, or the network does not fit the chip.
    """
    if Path(out).exists():
        raise ValueError(f"{out}: exists already, choose another name")
    graph = read_graph(source)
    dt = settings.dt or graph.metadata.get("dt")
    if dt is None:
        raise ValueError(f"{source}: has no dt; give the step of its time constants, such as --set dt=1e-4")
    layers = layers_of(graph, DT.of("dt", dt))
    x = _inputs(settings, layers[0].w_in.shape[1], seed)
    network, floats = on_chip(layers, x, graph.metadata.get("vth"))
    cores = partition(network.layers)
    chip = run_chip(network, x)
    lines = costs(counts(cores, chip))
    steps = len(layers) - (network.encoders is not None)
    spikes = [run.spikes[..., -sum(run.sizes) :] for run in (floats, chip)]
    report: dict[str, Any] = {
        "cores": len(cores),
        "energy_nJ_per_step": sum(line.nanojoules for line in lines),
        "latency_steps": steps,
        "latency_s": steps * float(dt),
        "spikes": int(np.count_nonzero(spikes[1])),
        "agreement": agreement(*spikes),
        "layers": [
            _layer(layer, *(floats.of_layer(each, k) for each in spikes)) for k, layer in enumerate(layers)
        ],
        "operations_per_step": {line.operation: line.count for line in lines},
        "used": [core.used() for core in cores],
    }
    if np.isinf(layers[-1].vth).all() and (size := np.mean(floats.estimate**2)):
        difference = chip.estimate / network.ones[-1] - floats.estimate
        report["rms_difference_of_outputs"] = float(np.sqrt(np.mean(difference**2) / size))
    tensors = {
        f"{k}.{name}": each for k, layer in enumerate(network.layers) for name, each in vars(layer).items()
    }
    tensors |= {"ones": np.array(network.ones), "encoders": network.encoders}
    whole = {name: np.ascontiguousarray(each) for name, each in tensors.items() if each is not None}
    write_whole(Path(out) / "network.safetensors", ordered(save(whole)))
    write_layers_c(out, network)
    write_whole(Path(out) / "report.json", json.dumps(report, indent=1, allow_nan=False) + "\n")
    return report


def _inputs(settings: ImportSettings, size: int, seed: int) -> Array:
    """Return inputs (n, T, size): the user's, or random spikes."""
    if settings.input is None:
        spikes = np.random.default_rng(seed).random((1, settings.steps, size)) < RANDOM_RATE
        return spikes.astype(np.float64)
    try:
        x = np.lib.format.open_memmap(settings.input, mode="r").astype(np.float64)
    except ValueError as error:
        raise ValueError(f"{settings.input}: not an array of numbers in NumPy's format") from error
    if x.ndim not in (2, 3) or x.shape[-1] != size or not x.size:
        raise ValueError(f"{settings.input}: shape {x.shape}, should be (T, {size}) or (n, T, {size})")
    if not (np.abs(x) * INPUT_ONE <= INPUT_MAX).all():
        raise ValueError(f"{settings.input}: should be finite and within ±{INPUT_MAX / INPUT_ONE:.2f}")
    return x.reshape(-1, *x.shape[-2:])


def on_chip(layers: Sequence[FloatLayer], x: Array, vth: int | None = None) -> tuple[ChipNetwork, Activity]:
    """Round a network for inputs (n, T, inputs), and run it in floats.

    Inputs of zeros and ones are spikes; other inputs are encoded. `vth` is the mantissa of the smallest
    threshold, if a file of quadsim gives one.
    """
    encoded = bool(np.any((x != 0) & (x != 1)))
    floats, peaks = float_activity(layers, x, encoded)
    drive = None
    if encoded:  # without the recurrent connections, which are the chip's
        alone = layers[0]._replace(w_rec=np.zeros_like(layers[0].w_rec))
        drive = float_activity([alone], x, encoded)[1][0].u
    one = None
    if vth is not None:
        smallest = min(layer.vth.min() for layer in layers)
        one = Between(1, VTH_MAX).of("vth", vth) * (1 << VTH_EXP) / smallest
    return quantise(layers, peaks, drive, one), floats


def float_activity(layers: Sequence[FloatLayer], x: Array, encoded: bool) -> tuple[Activity, list[Peaks]]:
    """Run a network in floats with the delays of the chip.

    Args:
        layers: From the input to the output.
        x: Inputs (n, T, inputs).
        encoded: Whether inputs drive the first layer within the step; otherwise they are spikes, which arrive
            a step later.

    Returns:
        Spikes, output potentials, and the peaks of each layer.
    """
    n, steps, _ = x.shape
    sizes = tuple(len(layer.w_in) for layer in layers)
    fired, u, v = ([np.zeros((n, size)) for size in sizes] for _ in range(3))
    spikes, outputs = np.zeros((n, steps, sum(sizes)), np.int8), np.zeros((n, steps, sizes[-1]))
    peaks = np.zeros((len(layers), 3))
    for t in range(steps):
        below = [x[:, t if encoded else t - 1] * (encoded or t > 0), *fired]
        before = fired
        fired = []
        for k, layer in enumerate(layers):
            arriving = below[k] @ layer.w_in.T + before[k] @ layer.w_rec.T + layer.bias
            u[k] = layer.syn * u[k] + arriving
            v[k] = layer.mem * np.where(before[k] > 0, 0.0, v[k]) + u[k]
            fired.append(1.0 * (v[k] > layer.vth))
            peaks[k] = np.maximum(peaks[k], [np.abs(each).max() for each in (arriving, u[k], v[k])])
        spikes[:, t], outputs[:, t] = np.concatenate(fired, axis=1), v[-1]
    nothing = np.zeros((n, sum(sizes)), np.int64)
    return Activity(sizes, spikes, nothing, outputs), [Peaks(*each) for each in peaks.tolist()]


def run_chip(network: ChipNetwork, x: Array) -> Activity:
    """Run a network on the emulated chip.

    Args:
        network: The network.
        x: Inputs (n, T, inputs): spikes, or values that the host encodes.

    Returns:
        Spikes, with spiking inputs first; activity; output potentials [state units].
    """
    emulator = LoihiNetwork(network.layers)
    emulator.reset(len(x))
    sizes = tuple(len(layer.w_in) for layer in network.layers)
    bias = encoded_inputs(network, x)
    spikes, outputs, active = [], [], np.zeros((len(x), sum(sizes)), np.int64)
    for t in range(x.shape[1]):
        if bias is None:
            emulator.step(x[:, t])
        else:
            emulator.step(bias_mant=bias[:, t] >> BIAS_EXP)
        u, v, s = (np.concatenate(each, axis=1) for each in (emulator.u, emulator.v, emulator.s))
        busy = (u != 0) | (v != 0) | (s != 0)
        if bias is not None:
            busy[:, : sizes[0]] |= bias[:, t] != 0
        active += busy
        spikes.append(np.concatenate([x[:, t].astype(np.int8), s], axis=1) if bias is None else s)
        outputs.append(v[:, -sizes[-1] :].astype(np.float64))
    return Activity(sizes, np.stack(spikes, axis=1), active, np.stack(outputs, axis=1))


def encoded_inputs(network: ChipNetwork, x: Array) -> NDArray[np.int32] | None:
    """Return the host's addition to the potentials of the first layer, (n, T, out) [state units].

    The result is None for spikes.
    """
    if network.encoders is None:
        return None
    n, steps, inputs = x.shape
    rows, neurons = network.encoders.shape
    blank = np.zeros((-rows % 3, neurons))  # `advance` takes its inputs by threes
    table = np.vstack([network.encoders, blank, network.layers[0].du]).astype(np.int32)
    whole = np.full((n, steps, len(table) - 1), INPUT_ONE, np.int32)
    whole[..., :inputs] = np.rint(x * INPUT_ONE)
    bias, total = np.zeros((n, steps, neurons), np.int32), np.zeros(neurons, np.int32)
    for copy, driven in zip(whole, bias, strict=True):
        current = np.zeros(neurons, np.int32)
        for t in range(steps):
            advance_encoders(copy[t], table, current, driven[t], total)
    return bias


def _layer(layer: FloatLayer, ours: NDArray[np.int8], theirs: NDArray[np.int8]) -> dict[str, Any]:
    """Return the part of the report on a layer, from its spikes in floats and on the chip."""
    return {
        "node": layer.name,
        "neurons": len(layer.w_in),
        "spikes_per_step": float(theirs.mean()),
        "spikes_per_step_in_floats": float(ours.mean()),
        "agreement": agreement(ours, theirs),
    }


def agreement(ours: NDArray[np.int8], theirs: NDArray[np.int8]) -> float | None:
    """Return the number of common spikes divided by the number of spikes in either run.

    The result is None without spikes.
    """
    either = np.count_nonzero(ours | theirs)
    return float(np.count_nonzero(ours & theirs) / either) if either else None
