"""Everything about the chip: `python docs/loihi.py [--train]` writes loihi.md and its figures.

It takes some minutes; with --train the small and the pruned networks are trained first, about an hour on one
core, into runs/size-* and runs/prune, where finished runs are kept.
"""

import argparse
import csv
import runpy
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

import matplotlib
import nir
import norse.torch
import numpy as np
import onnxruntime
import torch
from matplotlib.figure import Figure
from norse.torch.utils import import_nir
from numpy.typing import NDArray
from PIL import Image

from estimators.chip import LIMITS
from estimators.encoder import scaled_inputs
from estimators.energy import PAPER_MEASURED, gru_flops, snn_flops
from estimators.flights import Flights, load_flights
from estimators.inspection import FRACTIONS, Inspection, inspect, load_spiking, write_page
from estimators.inspection_figures import ablation_curve
from estimators.loihi import LoihiLayer, LoihiNetwork
from estimators.networks import OnLoihi, create_network, real_weights
from estimators.profiles import share_profiles
from estimators.pruning import CRITERIA, ablation, error_deg, importance
from estimators.spiking import Weights, forward
from estimators.weights_export import export_weights
from estimators.weights_file import Tensors, load_network, parameters, shipped_network
from quadsim.dataset import open_dataset
from quadsim.figures import STYLE
from training.loop import train
from training.pruning import prune

HERE = Path(__file__).parent
ROUNDING = 1e-12
"""Sines are the C library's: an angle may differ by that much [rad]."""
ROOT, IMAGES = HERE.parent, HERE / "img"
TRAIN = tuple(f"data/{name}.zarr" for name in ("train", "train-windy", "train-varied"))
VALIDATION = tuple(f"data/{name}.zarr" for name in ("val", "val-windy", "val-varied"))
SIZES, SIZE_EPOCHS, PRUNE_EPOCHS, PRUNE_STAGES = (12, 20, 28, 44), 40, 8, 2
PRUNE_LR = 0.005
RATES = {"rate_cost": 0.003, "rate_targets": (0.2, 0.4)}
"""Of small and of pruned networks: few neurons say less where they hardly spike."""
BEST_OF_PAPER = 2.79


def row(*cells: object) -> str:
    """A line of a table."""
    return "| " + " | ".join(map(str, cells)) + " |"


def compress(path: Path) -> None:
    """Line drawings need few colours."""
    Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=64).save(path, optimize=True)


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
        rows.append(row(path.stem.removeprefix("case_"), sum(net.sizes), steps, total, wrong))
    return rows


def core_rows(core: OnLoihi) -> list[str]:
    """The cores of the shipped network."""
    return [
        row(number, ", ".join(f"{k}: {len(ids)}" for k, ids in each.neurons.items()), *each.used().values())
        for number, each in enumerate(core.cores)
    ]


def profile_rows(flights: Flights) -> list[str]:
    """What sharing decay profiles costs."""
    config, tensors = shipped_network("att-snn")
    rows = [
        row("one a neuron", len(OnLoihi(config, tensors).cores), f"{error_deg(config, tensors, flights):.2f}")
    ]
    for profiles in (128, 64, 48, 32, 24):
        shared = share_profiles(tensors, profiles)
        cores = len(OnLoihi(config, shared).cores)
        rows.append(row(profiles, cores, f"{error_deg(config, shared, flights):.2f}"))
    return rows


def latency_rows(rounds: int) -> list[str]:
    """Latency of every estimator in turns, and its figure."""
    bench = runpy.run_path(str(ROOT / "benchmarks" / "bench_latency.py"))
    taken = bench["measure"](bench["contenders"](), rounds)
    bench["draw"](taken, IMAGES / "loihi-latency.png")
    compress(IMAGES / "loihi-latency.png")
    chip = float(np.median(taken["att-snn-loihi"]))
    found = sorted((*np.percentile(each, [50, 99]), name) for name, each in taken.items())
    return [row(name, f"{middle:.2f}", f"{high:.2f}", f"{middle / chip:.2f}") for middle, high, name in found]


def energy_rows(found: Inspection) -> list[str]:
    """The energy model line by line, and its sum."""
    rows = [
        row(
            each.operation, f"{each.count:.1f}", f"{each.picojoules:g}", f"{each.nanojoules:.2f}",
            f"{each.share:.1%}",
        )
        for each in found.costs
    ]  # fmt: skip
    return [*rows, row("sum", "", "", f"{sum(each.nanojoules for each in found.costs):.1f}", "")]


def flop_rows(found: Inspection) -> list[str]:
    """Floating-point operations of both networks."""
    config = found.config
    first, second = (float(found.layer_rates(k).sum()) for k in (0, 1))
    snn = snn_flops(config.encoding, config.hidden, (first, second))
    twin, _ = shipped_network("att-rnn")
    gru = gru_flops(twin.encoding, twin.hidden)
    return [
        row(f"Att-SNN, {first:.1f} + {second:.1f} spikes", f"{snn['sparse']:.0f}"),
        row("Att-SNN, zeros multiplied too", f"{snn['dense']:.0f}"),
        row(f"Att-RNN, {gru / snn['sparse']:.0f} times the first", f"{gru:.0f}"),
    ]


def export_rows(flights: Flights) -> list[str]:
    """Exports run by a compiler, Norse and ONNX Runtime over a validation flight."""
    gyro, accel = flights.gyro[:1], flights.accel[:1]
    with tempfile.TemporaryDirectory() as folder:
        return [
            _c_row(Path(folder), gyro, accel),
            _nir_row(Path(folder), gyro[:, :4000], accel[:, :4000]),
            _onnx_row(Path(folder), gyro, accel),
        ]


def _c_row(folder: Path, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> str:
    source = export_weights("att-snn", folder / "c", "c99")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", f"-I{source}"]
    driver = ROOT / "tests" / "data" / "loihi" / "driver.c"
    program = folder / "run"
    subprocess.run(["cc", *flags, source / "att_snn.c", driver, "-lm", "-o", program], check=True)
    samples = np.concatenate([gyro[0], accel[0]], 1)
    done = subprocess.run([program], input=samples.tobytes(), capture_output=True, check=True)
    states = np.frombuffer(done.stdout, np.uint8).reshape(len(samples), -1)
    core = create_network("att-snn-loihi").core
    assert isinstance(core, OnLoihi)
    ours = np.empty((*gyro.shape[:2], 2))
    core.run(core.zero(1), gyro, accel, ours)
    theirs = states[:, -16:].copy().view(np.float64)
    wrong = int(np.sum(np.abs(theirs - ours[0]) > ROUNDING))
    size = (source / "att_snn.c").stat().st_size // 1024
    return row(
        f"C99, {size} kB of source", f"`cc {' '.join(flags[:4])}`", f"{ours.size} outputs", f"{wrong} differ"
    )


def _nir_row(folder: Path, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> str:
    config, tensors = shipped_network("att-snn")
    graph = nir.read(export_weights("att-snn", folder / "snn.nir", "nir"))
    spiking = ("input", "w_in", "encoding", "w_ff", "w_rec", "hidden")
    nodes = {name: graph.nodes[name] for name in spiking}
    nodes["finish"] = nir.Output({"output": np.array([config.hidden])})
    edges = [edge for edge in graph.edges if set(edge) <= set(nodes)] + [("hidden", "finish")]
    for name in ("encoding", "hidden"):  # a potential at the threshold is not left to rounding errors
        nodes[name].v_threshold += 1e-11
    import_nir._to_tensor = lambda x: torch.as_tensor(x, dtype=torch.float64)
    net = norse.torch.from_nir(nir.NIRGraph(nodes, edges), dt=float(graph.metadata["dt"])).double()
    x = torch.tensor(scaled_inputs(config.inputs, config.rate_hz, gyro, accel)[0])
    weights, taus = real_weights(config, tensors)
    own = Weights(*map(torch.tensor, (*weights, *taus)))
    _, _, floats = forward(x, own)
    _, _, chip = forward(x, own, quantised=True)
    state, spikes = None, []
    with torch.no_grad():
        for t in range(x.shape[1]):
            spike, state = net(x[:, t], state)
            spikes.append(spike)
    wrong = int((torch.stack(spikes, 1)[:, :-1] != floats[:, 1:]).sum())
    apart = float((floats != chip).double().mean())
    said = f"{wrong} differ (without the chip's rounding; {apart:.1%} of the chip's own differ from those)"
    return row("NIR", "Norse", f"{floats[:, 1:].numel()} hidden spikes", said)


def _onnx_row(folder: Path, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> str:
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
    theirs = session.run(["roll_pitch"], feed | zero)[0].transpose(1, 0, 2)
    est = create_network("att-rnn")
    worst = np.degrees(np.abs(theirs - est.sequence(gyro, accel)).max())
    return row("ONNX", "ONNX Runtime", f"{theirs.size} outputs", f"largest difference {worst:.1e}°")


def train_sizes() -> None:
    """Train the small networks, and score them."""
    common = {"preset": "best", "data": TRAIN, "validation": VALIDATION, **RATES}
    common |= {"parameters": 0, "revive": 0.6}  # nothing to take away: all the epochs may revive
    rows = []
    for size in SIZES:
        result = train(
            "att-snn", out=f"runs/size-{2 * size}", encoding=size, hidden=size, epochs=SIZE_EPOCHS, **common
        )
        rows.append(result.weights)
    alone, every = flights_of(VALIDATION[:1]), flights_of(VALIDATION)
    with (HERE / "loihi-size.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["neurons", "parameters", "val_deg", "all_deg"])
        for path in rows:
            config, tensors = load_network(path)
            size = parameters(tensors)
            errors = [f"{error_deg(config, tensors, flights):.3f}" for flights in (alone, every)]
            writer.writerow([config.encoding + config.hidden, size, *errors])


def train_pruned() -> None:
    """Prune the shipped network step by step."""
    stages = prune(
        TRAIN, VALIDATION, "runs/prune", fraction=0.4, stages=PRUNE_STAGES, epochs=PRUNE_EPOCHS,
        seed=1, optimiser_lr=PRUNE_LR,
    )  # fmt: skip
    with (HERE / "loihi-pruning.csv").open("w", newline="") as file:
        names = [*(name for name in asdict(stages[0]) if name != "weights"), "epochs"]
        writer = csv.DictWriter(file, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(asdict(stage) | {"epochs": PRUNE_EPOCHS} for stage in stages)


def table_of(name: str) -> list[dict[str, str]]:
    """A table that a training left."""
    with (HERE / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def size_rows(shipped: Sequence[float]) -> list[str]:
    """The front of error against size, and its figure."""
    found = table_of("loihi-size")
    config, tensors = shipped_network("att-snn")
    whole = (config.encoding + config.hidden, parameters(tensors))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.0, 3.0), layout="constrained")
        axes = figure.subplots()
        x = [*(int(each["parameters"]) for each in found), whole[1]]
        for k, (name, mark) in enumerate((("val_deg", "o"), ("all_deg", "s"))):
            y = [*(float(each[name]) for each in found), shipped[k]]
            label = ("val.zarr", "all validation flights")[k]
            axes.plot(x, y, mark, color=("#33658a", "#c0563b")[k], mfc="none" if k else None, label=label)
        for each in found:
            axes.annotate(
                each["neurons"],
                (int(each["parameters"]), float(each["val_deg"])),
                (4, 5),
                textcoords="offset points",
                fontsize=7,
            )
        axes.annotate(
            f"{whole[0]}, shipped",
            (whole[1], shipped[0]),
            (-6, -3),
            textcoords="offset points",
            fontsize=7,
            ha="right",
        )
        axes.axhline(BEST_OF_PAPER, color="#111111", lw=0.8, ls=":")
        axes.annotate(
            "the paper's 2.79°", (x[0], BEST_OF_PAPER), (0, -9), textcoords="offset points", fontsize=7
        )
        axes.axvline(5000, color="#999999", lw=0.8, ls=":")
        axes.set(xscale="log", xlabel="parameters", ylabel="mean absolute error [°]")
        axes.legend(fontsize=8)
    save(figure, "size")
    rows = [row(*(each[name] for name in ("neurons", "parameters")), *_degrees(each)) for each in found]
    return [*rows, row(f"{whole[0]}, shipped", whole[1], *(f"{error:.2f}" for error in shipped))]


def _degrees(each: dict[str, str]) -> list[str]:
    return [f"{float(each[name]):.2f}" for name in ("val_deg", "all_deg")]


def pruning_rows(found: Inspection, tensors: Tensors, flights: Flights) -> list[str]:
    """The pruned networks, and the ablation figure with them."""
    stages = table_of("loihi-pruning")
    tuned = [(float(each["removed"]), float(each["tuned_deg"])) for each in stages]
    curves = {
        by: ablation(found.config, tensors, importance(tensors, found.activity, by), FRACTIONS, flights)
        for by in CRITERIA
    }
    save(ablation_curve(FRACTIONS, curves, tuned), "ablation")
    return [
        row(
            f"{float(each['removed']):.0%}", f"{each['encoding']} + {each['hidden']}", each["parameters"],
            f"{float(each['cut_deg']):.2f}", f"{float(each['tuned_deg']):.2f}",
        )
        for each in stages
    ]  # fmt: skip


def save(figure: Figure, name: str) -> None:
    """Write a figure of the page."""
    figure.savefig(IMAGES / f"loihi-{name}.png", dpi=130)
    compress(IMAGES / f"loihi-{name}.png")


def flights_of(paths: Iterable[str]) -> Flights:
    """Whole datasets as arrays."""
    return load_flights([open_dataset(ROOT / path) for path in paths])


def main() -> None:
    """Measure everything and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--train", action="store_true", help="train the small and the pruned networks first")
    parser.add_argument("--rounds", type=int, default=60, help="turns of 100 calls for the latency")
    arguments = parser.parse_args()
    if arguments.train:
        train_sizes()
        train_pruned()
    alone, every = flights_of(VALIDATION[:1]), flights_of(VALIDATION)
    name, config, tensors = load_spiking()
    found = inspect(name, config, tensors, alone)
    with tempfile.TemporaryDirectory() as folder:
        write_page(folder, found)
        for picture in ("rates", "raster", "membranes", "inputs", "tuning"):
            (IMAGES / f"loihi-{picture}.png").write_bytes((Path(folder) / f"{picture}.png").read_bytes())
            compress(IMAGES / f"loihi-{picture}.png")
    texts = {
        "golden": golden_rows(),
        "cores": core_rows(found.core),
        "profiles": profile_rows(alone),
        "latency": latency_rows(arguments.rounds),
        "energy": energy_rows(found),
        "flops": flop_rows(found),
        "summary": [row(*each) for each in found.summary()],
        "inputs": [
            row(key, f"{each.error_deg:.2f}", f"{each.gain:.2f}") for key, each in found.responses.items()
        ],
        "pruning": pruning_rows(found, tensors, every),
        "sizes": size_rows([error_deg(config, tensors, flights) for flights in (alone, every)]),
        "exports": export_rows(alone),
    }
    smallest = table_of("training/thinning")[-1]
    words = {key: "\n".join(rows) for key, rows in texts.items()} | {
        "limits": " | ".join(f"{key} ({limit})" for key, limit in LIMITS.items()),
        "limit_lines": "|".join("---" for _ in LIMITS),
        "flights": str(len(alone.gyro)),
        "paper": " and ".join(f"{value:g} {unit}" for unit, value in PAPER_MEASURED.items()) + " a step",
        "prune_epochs": table_of("loihi-pruning")[-1]["epochs"],
        "size_epochs": str(SIZE_EPOCHS),
        "thin_parameters": smallest["parameters"],
        "thin_neurons": smallest["neurons"],
        "thin_deg": f"{float(smallest['val_error_deg']):.2f}",
        "thin_epochs": smallest["epochs"],
        "thin_most": smallest["keeps"],
    }
    page = (HERE / "loihi.template.md").read_text()
    for key, text in words.items():
        page = page.replace(f"{{{key}}}", text)
    (HERE / "loihi.md").write_text(page)


if __name__ == "__main__":
    main()
