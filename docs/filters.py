"""Compare the estimators on flights held out from tuning and training: `python docs/filters.py`.

Writes filters.md and its figures. The flights are those of the commands in filters.md; those that are missing
are generated.
"""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from estimators import create, names
from estimators.evaluate import Evaluation, evaluate
from estimators.figures import settling, violins
from estimators.flights import Flights, load_flights
from estimators.metrics import attitude_error
from estimators.protocol import run_quietly
from estimators.tuned import load_tuning
from quadsim.console import progress_bar
from quadsim.dataset import generate, open_dataset
from quadsim.figures import STYLE
from quadsim.recipe import flight_config, load_recipe
from scenarios.summary import behind

Array = NDArray[np.float64]
HERE = Path(__file__).parent
IMAGES = HERE / "img"
DATA = HERE.parent / "data"

DOMAINS = {
    "hummingbird-adis16448": ("hummingbird", 3, DATA / "test.zarr"),
    "px4-quad-px4-mini": ("px4", 6, DATA / "test-px4.zarr"),
}
"""Domain to recipe, seed and place of its 16 test flights of 100 s."""
LEFT_OUT = ("truth", "att-snn")
"""The truth has no error, and att-snn is att-snn-loihi in floats."""
SLOW_FLIGHTS = 2
EXPLAINED = ("mahony", "madgwick", "ekf", "eskf", "vqf", "ekf-drag")


def compress(path: Path) -> None:
    """Line drawings need few colours."""
    Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=96).save(path, optimize=True)


def compared(domain: str) -> Evaluation:
    """All estimators on the domain's test flights; draws the figures."""
    recipe, seed, path = DOMAINS[domain]
    if not path.exists():
        generate(flight_config(load_recipe(recipe)), 16, 100.0, path, seed=seed)
    shown = [name for name in names() if name not in LEFT_OUT]
    with progress_bar(domain, "runs") as bar:
        done = evaluate(open_dataset(path), shown, tuning=domain, slow_flights=SLOW_FLIGHTS, progress=bar)
    figures = {"violins": violins(done), "convergence": settling(done)}
    for name, figure in figures.items():
        figure.savefig(IMAGES / f"filters-{name}-{domain}.png", dpi=110)
        compress(IMAGES / f"filters-{name}-{domain}.png")
    return done


def result_rows(done: Evaluation) -> list[str]:
    """The table, unknown starts first, best first."""
    rows = []
    for row in sorted(done.rows, key=lambda row: (row.initial != "unknown", row.mean_deg)):
        settled = [f"{s:.1f}" if np.isfinite(s) else "never" for s in (row.settle_20_s, row.settle_45_s)]
        name = row.estimator + ("*" if row.flights < max(each.flights for each in done.rows) else "")
        mean = f"{row.mean_deg:.2f} ({row.mean_low_deg:.2f}–{row.mean_high_deg:.2f})"
        numbers = [f"{row.median_deg:.2f}", mean, f"{row.sd_deg:.2f}", behind(row)]
        shown = [name, row.initial, *numbers, f"{row.inclination_rmse_deg:.2f}", *settled]
        rows.append(f"| {' | '.join(shown)} |")
    return rows


def parameter_rows(domain: str) -> list[str]:
    """Tuned values, the cost they reached, and how they were searched."""
    rows = []
    for name, table in load_tuning(domain).items():
        if name.endswith("filterpy"):
            continue
        values = ", ".join(f"`{key}` {value:.4g}" for key, value in table.values.items())
        options = table.command.split(" --out ")[0].split(" --data ", 1)[-1]
        rows.append(
            f"| {name} | {values} | {table.rmse_deg:.2f} | {table.evaluations} | `--data {options}` |"
        )
    return rows


def without(flights: Flights, gyro_bias: Array, accel_bias: Array) -> dict[str, Flights]:
    """The flights as recorded, and each with one thing put right."""
    up = np.stack(
        [
            -np.sin(flights.truth[..., 1]),
            np.cos(flights.truth[..., 1]) * np.sin(flights.truth[..., 0]),
            np.cos(flights.truth[..., 1]) * np.cos(flights.truth[..., 0]),
        ],
        axis=-1,
    )
    return {
        "as recorded": flights,
        "gyroscope bias removed": replace(flights, gyro=flights.gyro - gyro_bias),
        "accelerometer bias removed": replace(flights, accel=flights.accel - accel_bias),
        "both removed": replace(flights, gyro=flights.gyro - gyro_bias, accel=flights.accel - accel_bias),
        "accelerometer reads gravity and its bias": replace(flights, accel=9.81 * up + accel_bias),
    }


def mean_error(name: str, flights: Flights, domain: str, **params: float) -> float:
    """Mean over flights of the mean absolute error [deg]."""
    est = create(name, flights.rate_hz, tuning=domain, **params)
    return attitude_error(run_quietly(est, flights.gyro, flights.accel, flights.start), flights.truth).mean


def both_starts(
    name: str, flights: Flights, domain: str, changes: Mapping[str, dict[str, float]]
) -> list[str]:
    """Error with each change of parameters, from an unknown and from a known start."""
    known, rows = flights.known(), []
    for what, params in changes.items():
        errors = [mean_error(name, each, domain, **params) for each in (flights, known)]
        rows.append(f"| {what} | {errors[0]:.2f} | {errors[1]:.2f} |")
    return rows


def cause_rows(domain: str) -> list[str]:
    """Error of filters when one cause of error is taken away."""
    dataset = open_dataset(DOMAINS[domain][2])
    biases = (dataset[name].to_numpy().astype(np.float64) for name in ("gyro_bias", "accel_bias"))
    kinds = {what: each.known() for what, each in without(load_flights([dataset]), *biases).items()}
    return [
        f"| {name} | {' | '.join(f'{mean_error(name, each, domain):.2f}' for each in kinds.values())} |"
        for name in EXPLAINED
    ]


def drag_rows(domain: str) -> list[str]:
    """Error of ekf-drag when what it knows of drag is wrong, or not used."""
    flights = load_flights([open_dataset(DOMAINS[domain][2])])
    exact = load_tuning(domain)["ekf-drag"].values
    free = {"speed_noise": 1e3, "climb_noise": 1e3}
    changes: Mapping[str, dict[str, float]] = {
        "drag as it is": {},
        "drag taken for half of what it is": {"drag_time": 2.0 * exact["drag_time"]},
        "drag taken for twice what it is": {"drag_time": 0.5 * exact["drag_time"]},
        "drag not used (`drag_noise` 100)": {"drag_noise": 100.0},
        "velocity taken for free (`speed_noise`, `climb_noise` 1000)": free,
        "neither drag nor velocity used": {"drag_noise": 100.0} | free,
        "accelerometer bias not estimated (`accel_bias_sigma` 0.001)": {"accel_bias_sigma": 0.001},
    }
    return both_starts("ekf-drag", flights, domain, changes)


def vqf_rows(domain: str) -> list[str]:
    """VQF with its package's own parameters and tuned, with and without its bias estimation."""
    flights = load_flights([open_dataset(DOMAINS[domain][2])])
    own = {"tauAcc": 3.0, "biasForgettingTime": 100.0, "biasSigmaInit": 0.5, "biasSigmaMotion": 0.1}
    changes: Mapping[str, dict[str, float]] = {
        "tuned": {},
        "the package's defaults": own | {"biasSigmaRest": 0.03},
        "tuned, without estimating the bias": {"motionBiasEstEnabled": 0.0, "restBiasEstEnabled": 0.0},
        "tuned, `tauAcc` a third": {"tauAcc": load_tuning(domain)["vqf"].values["tauAcc"] / 3.0},
        "tuned, `tauAcc` three times": {"tauAcc": load_tuning(domain)["vqf"].values["tauAcc"] * 3.0},
    }
    return both_starts("vqf", flights, domain, changes)


def speeds() -> list[str]:
    """What the benchmark prints."""
    bench = HERE.parent / "benchmarks" / "bench_filters.py"
    command = [sys.executable, str(bench), "--tuning", "mahony", "ekf"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()


def main() -> None:
    """Measure everything and write the page."""
    matplotlib.rcParams.update(STYLE)
    IMAGES.mkdir(exist_ok=True)
    first = next(iter(DOMAINS))
    tables = {f"results:{domain}": result_rows(compared(domain)) for domain in DOMAINS}
    tables |= {f"parameters:{domain}": parameter_rows(domain) for domain in DOMAINS}
    for domain in DOMAINS:
        tables |= {f"causes:{domain}": cause_rows(domain), f"drag:{domain}": drag_rows(domain)}
    tables |= {"vqf": vqf_rows(first), "speed": speeds()}
    page = (HERE / "filters.template.md").read_text()
    for name, rows in tables.items():
        page = page.replace(f"{{{name}}}", "\n".join(rows))
    (HERE / "filters.md").write_text(page)


if __name__ == "__main__":
    main()
