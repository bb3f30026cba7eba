"""What of the chip helps, and how many parameters: `python docs/search.py` writes search.md from search.csv.

    python docs/search.py --train --data FOLDER

trains the networks of the page that search.csv lacks, all of them without that file. FOLDER holds the flights
of att-snn, `train/*.zarr` and `val/*.zarr`, which the commands of its card make. All networks take about an
hour of one core; what was stopped goes on.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import ROOT, load_page, row
from scipy.stats import t as student

from estimators.evaluation.flights import Flights, load_flights
from estimators.metrics import attitude_error
from estimators.networks.network import create_network
from estimators.networks.weights_file import load_network, parameters
from quadsim.dataset.reading import open_dataset
from quadsim.runs.files import write_csv
from training.loop import train
from training.run_folder import commit

CSV = ROOT / "docs" / "search.csv"
PRESET, EPOCHS, BATCHES, SEEDS = "best", 10, 800, (1, 2, 3)
NEURONS = 100
"""Of each layer in the ablation, as in the paper."""
WHOLE = "everything"
OPTIONS: dict[str, dict[str, Any]] = {
    WHOLE: {},
    "no after-spike currents": {"after_spike": False},
    "no finer weights": {"finest_exponent": 0},
    "neither of the two": {"after_spike": False, "finest_exponent": 0},
    "no shared weights": {"symmetric": False},
    "two steps a sample": {"steps_per_sample": 2},
    "synaptic delay": {"recurrent_delay": 2},
    "random initial weights": {"initialisation": "random"},
}
SIZES = (32, 64, 128, 168)
"""Neurons of each layer of the other networks of the front."""
PAPER = 21202
"""Parameters of the paper's network."""
FLYING = (
    "hummingbird", "windy", "gusty-px4mini", "robust-px4", "robust-crazyflie", "varied-px4-raw",
    "turbulent-raw", "wide-crazyflie-raw", "fast-wind", "cruise-px4", "carried",
)  # fmt: skip
IN_THE_HAND = ("hand-held", "hand-held-raw", "tumbling")
SHOWN = {"hummingbird": "Hummingbird", "robust-px4": "rough px4-quad", "robust-crazyflie": "rough Crazyflie"}


def arms() -> list[tuple[str, int, int]]:
    """Option, neurons and seed of each training."""
    sizes = [(WHOLE, size) for size in SIZES]
    return [(*arm, seed) for seed in SEEDS for arm in [*((name, NEURONS) for name in OPTIONS), *sizes]]


def trained(option: str, neurons: int, seed: int, data: Path) -> dict[str, Any]:
    """Train one network, or read it back; its row of the table."""
    sets = {part: tuple(map(str, sorted((data / part).glob("*.zarr")))) for part in ("train", "val")}
    result = train(
        data=sets["train"],
        validation=sets["val"],
        out=data / "search" / f"{option.replace(' ', '-')}-{neurons}-{seed}",
        preset=PRESET,
        **{"encoding": neurons, "hidden": neurons, "seed": seed, "epochs": EPOCHS, "batches": BATCHES},
        **OPTIONS[option],
    )
    config, tensors = load_network(result.weights)
    found = {"option": option, "neurons": neurons, "seed": seed, "parameters": parameters(tensors)}
    found |= {"updates": EPOCHS * BATCHES, "training_rmse_deg": round(result.best.train_rmse_deg, 3)}
    for path in sets["val"]:
        found[Path(path).stem] = round(error_deg(result.weights, config.rate_hz, Path(path)), 3)
    return found | {"commit": commit()}


def error_deg(weights: Path, rate_hz: float, path: Path) -> float:
    """Mean absolute error of roll and pitch from an unknown start [°]."""
    flights: Flights = load_flights([open_dataset(path)])
    est = create_network("att-snn", rate_hz, weights)
    est.reset(len(flights.gyro))
    return attitude_error(est.sequence(flights.gyro, flights.accel), flights.truth).mean


def with_interval(values: NDArray[np.float64]) -> str:
    """Mean and 95 % interval of the mean of a few trainings, Student's t."""
    half = student.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{np.mean(values):.2f} ± {half:.2f}"


Rows = list[dict[str, str]]


def errors(found: Rows, *sets: str) -> NDArray[np.float64]:
    """Error of each training, the mean over validation sets [°]."""
    return np.array([[float(each[name]) for name in sets] for each in found]).mean(axis=1)


def cells(found: Rows) -> list[str]:
    """Parameters, and errors of the trainings of one network."""
    columns = [errors(found, *sets) for sets in (*([name] for name in SHOWN), FLYING, IN_THE_HAND)]
    return [found[0]["parameters"], *map(with_interval, columns)]


def front_figure(by_size: list[Rows]) -> Figure:
    """Error against parameters."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes = figure.subplots()
    for (name, label), colour in zip(SHOWN.items(), ("#33658a", "#c0563b", "#6a994e"), strict=True):
        size = [int(each[0]["parameters"]) for each in by_size]
        error = np.array([errors(each, name) for each in by_size])
        axes.plot(size, error.mean(axis=1), color=colour, linewidth=1.6, label=label)
        axes.plot(size, error, "o", color=colour, markersize=3)
    axes.axvline(PAPER, color="black", linewidth=0.8, linestyle=":")
    axes.annotate(
        "the paper's 21 202", (PAPER, 0.98), (4, 0), ("data", "axes fraction"), "offset points",
        va="top", fontsize="small",
    )  # fmt: skip
    axes.set(xscale="log", xlabel="parameters", ylabel="error, unknown start [°]")
    axes.set_xticks([2000, 5000, 10000, 20000, 50000], ["2 000", "5 000", "10 000", "20 000", "50 000"])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return figure


def read() -> Rows:
    """The trainings so far."""
    return list(csv.DictReader(CSV.read_text(encoding="utf-8").splitlines())) if CSV.is_file() else []


def arm_of(found: dict[str, str]) -> tuple[str, int, int]:
    """Option, neurons and seed of a training."""
    return found["option"], int(found["neurons"]), int(found["seed"])


def main(arguments: Sequence[str] | None = None) -> None:
    """Train where asked to; write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--train", action="store_true", help="train the networks and write search.csv")
    parser.add_argument("--data", type=Path, default=ROOT / "data", help="folder of the flights")
    given = parser.parse_args(arguments)
    if given.train:
        for option, neurons, seed in arms():
            if not any(arm_of(each) == (option, neurons, seed) for each in read()):
                row_of_it = trained(option, neurons, seed, given.data)
                write_csv(CSV, [*read(), row_of_it])
                print(row_of_it, flush=True)
    found = read()
    of: dict[tuple[str, int], Rows] = {}
    for each in found:
        of.setdefault((each["option"], int(each["neurons"])), []).append(each)
    by_size = [of[WHOLE, size] for size in sorted((*SIZES, NEURONS))]
    page = load_page("search")
    page.save(front_figure(by_size), "search.png", colours=64)
    page.write(
        {
            "updates": found[0]["updates"],
            "commit": ", ".join(dict.fromkeys(each["commit"] for each in found)),
            "seeds": str(len(SEEDS)),
            "options": [row(name, *cells(of[name, NEURONS])) for name in OPTIONS],
            "sizes": [row(f"{each[0]['neurons']} + {each[0]['neurons']}", *cells(each)) for each in by_size],
        }
    )


if __name__ == "__main__":
    main()
