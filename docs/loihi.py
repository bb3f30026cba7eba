"""The page loihi.md: everything about the chip."""

import subprocess
import tempfile
from argparse import Namespace
from pathlib import Path

import matplotlib
import nir
import norse.torch
import numpy as np
import onnxruntime
import torch
from deploy import emulated
from numpy.typing import NDArray
from pages import ROOT, Page, Parts, confirmed, reduce_colours, row
from simulated import simulated
from snntorch.import_nir import import_from_nir

from estimators.analysis.ablation import error_deg
from estimators.analysis.energy import HOST_PICOJOULES, PAPER_MEASURED, host_costs
from estimators.analysis.inspection import FRACTIONS, Inspection, inspect, load_spiking, write_page
from estimators.analysis.inspection_figures import ablation_curve
from estimators.analysis.latency import PAPER_US, contenders, measure
from estimators.evaluation.flights import Flights, load_flights
from estimators.export.formats import export_weights
from estimators.export.nir_graph import STEP
from estimators.loihi.chip import LIMITS
from estimators.loihi.neurons import LoihiLayer, LoihiNetwork
from estimators.networks.decay_profiles import share_profiles
from estimators.networks.encoder import scaled_inputs
from estimators.networks.network import OnLoihi, create_network, real_weights, silenced
from estimators.networks.weights_file import Tensors, shipped_network
from estimators.spiking import Weights, forward
from quadsim.dataset.figures import STYLE
from quadsim.rotation import roll_pitch_of_up

ROUNDING_DEG = 1e-2
"""Largest difference in ONNX Runtime: in float32 a reading may be rounded the other way [°]."""
ROUNDED_SPIKES = 1e-3
"""Share of the spikes that may differ in another tool, which computes in float32."""
PROFILES = (128, 64, 48, 32, 24)
LATENCY_ROUNDS = 60
"""Turns of 100 calls."""


def golden_rows() -> list[str]:
    """Every state of the golden vectors."""
    rows = []
    folder = ROOT / "tests" / "data" / "loihi"
    for path in sorted(folder.glob("case_*.npz")):
        case, wanted = dict(np.load(path)), np.load(folder / path.name.replace("case", "golden_lava"))
        exponent = case.get("bias_seq_exp_L0", case["L0_bias_exp"])
        layers = [
            LoihiLayer(
                case.get(f"L{k}_W_in"), case.get(f"L{k}_W_rec"),
                *(case[f"L{k}_{name}"] for name in ("du", "dv", "vth", "bias_mant")),
                exponent if k == 0 else case[f"L{k}_bias_exp"],
            )
            for k in range(int(case["n_layers"]))
        ]  # fmt: skip
        net = LoihiNetwork(layers)
        spikes, bias = case.get("s_in"), case.get("bias_seq_mant_L0")
        total, wrong, steps = 0, 0, len(wanted["L0_u"])
        for t in range(steps):
            net.step(None if spikes is None else spikes[t], None if bias is None else bias[t])
            for name, states in (("u", net.u), ("v", net.v), ("s", net.s)):
                for k, state in enumerate(states):
                    total += state.size
                    wrong += int(np.sum(state[0] != wanted[f"L{k}_{name}"][t]))
        name = path.stem.removeprefix("case_")
        confirmed(f"{name}: states that differ from Lava's", wrong)
        rows.append(row(name, sum(net.sizes), steps, total, wrong))
    return rows


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


def export_rows(flights: Flights) -> list[str]:
    """Exports run by a compiler, Norse, snnTorch and ONNX Runtime over a validation flight.

    Raises:
        ValueError: One of them does not compute the network.
    """
    gyro, accel = flights.gyro[:1], flights.accel[:1]
    with tempfile.TemporaryDirectory() as folder:
        return [
            c_row(Path(folder), gyro, accel),
            *nir_rows(Path(folder), gyro[:, :4000], accel[:, :4000]),
            onnx_row(Path(folder), gyro, accel),
        ]


def c_row(folder: Path, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> str:
    """The C code against the emulated chip."""
    source = export_weights("att-snn", folder / "c", "c99")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", f"-I{source}"]
    driver = ROOT / "tests" / "data" / "loihi" / "driver.c"
    program = folder / "run"
    subprocess.run(["cc", *flags, source / "att_snn.c", driver, "-lm", "-o", program], check=True)
    samples = np.concatenate([gyro[0], accel[0]], 1)
    done = subprocess.run([program], input=samples.tobytes(), capture_output=True, check=True)
    states = np.frombuffer(done.stdout, np.uint8).reshape(len(samples), -1)
    ours = emulated("att-snn", gyro[0], accel[0])
    theirs = states[:, -8 * ours.shape[1] :].copy().view(np.float64)
    wrong = confirmed("C99: outputs that differ from the emulator's", int((theirs != ours).sum()))
    size = (source / "att_snn.c").stat().st_size // 1024
    return row(
        f"C99, {size} kB of source", f"`cc {' '.join(flags[:4])}`", f"{ours.size} outputs", f"{wrong} differ"
    )


def nir_rows(folder: Path, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> list[str]:
    """The NIR graph in Norse and in snnTorch, whose hidden layer is a step ahead, against floats."""
    file = export_weights("att-snn", folder / "snn.nir", "nir")
    config, tensors = shipped_network("att-snn")
    x = torch.tensor(scaled_inputs(config.inputs, gyro, accel))
    own = Weights(*map(torch.tensor, real_weights(config, tensors)))
    _, _, floats = forward(x, own)
    _, _, chip = forward(x, own, quantised=True)
    rounding = float((floats != chip).double().mean())
    tools = {
        "Norse": (norse.torch.from_nir(nir.read(file), dt=STEP), lambda state: state.cache["06_hidden"]),
        "snnTorch": (import_from_nir(nir.read(file)), lambda state: state["06_hidden_prev_output"]),
    }
    rows = []
    for tool, (network, spikes_of) in tools.items():
        state, spikes = None, []
        with torch.no_grad():
            for sample in x.float().unbind(1):
                _, state = network(sample, state)
                spikes.append(spikes_of(state))
        wrong = torch.stack(spikes, 1)[:, :-1] != floats[:, 1:]
        confirmed(f"{tool}: share of spikes that differ", float(wrong.double().mean()), ROUNDED_SPIKES)
        without = f"without the chip's rounding, which changes {rounding:.1%} of the spikes"
        result = f"{int(wrong.sum())} differ ({without})"
        rows.append(row("NIR", tool, f"{wrong.numel()} hidden spikes", result))
    return rows


def onnx_row(folder: Path, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> str:
    """The ONNX graph against the estimator."""
    session = onnxruntime.InferenceSession(export_weights("att-rnn", folder / "rnn.onnx", "onnx"))
    config, _ = shipped_network("att-rnn")
    zero = {
        f"h{k}": np.zeros((1, 1, units), np.float32)
        for k, units in enumerate((config.encoding, config.hidden))
    }
    feed = {
        "gyro": gyro.transpose(1, 0, 2).astype(np.float32),
        "accel": accel.transpose(1, 0, 2).astype(np.float32),
    }
    theirs = roll_pitch_of_up(session.run(["up"], feed | zero)[0].transpose(1, 0, 2))
    est = create_network("att-rnn")
    worst = float(np.degrees(np.abs(theirs - est.sequence(gyro, accel)).max()))
    confirmed("ONNX: largest difference [°]", worst, ROUNDING_DEG)
    return row("ONNX", "ONNX Runtime", f"{theirs.size} outputs", f"largest difference {worst:.1e}°")


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
        "golden": golden_rows(),
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
        "exports": export_rows(flights),
    }
