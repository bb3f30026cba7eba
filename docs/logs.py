"""Measure what the page on real logs says: `QUADSIM_REALDATA=folder python docs/logs.py` writes logs.md."""

import os
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from typer.testing import CliRunner

from estimators import create, run
from estimators.metrics import inclination_error
from estimators.recorded import KNOWN, RAW, LogScores, default_names, draw_log, score_logs
from quadsim.cli import app
from quadsim.dataset import generate, open_dataset
from quadsim.export import export
from quadsim.figures import STYLE
from quadsim.imu import load_imu, simulate_imu
from quadsim.logs import read_log
from quadsim.logs.allan import calibrate, draw
from quadsim.logs.recording import Recording
from quadsim.logs.resample import resample
from quadsim.recipe import flight_config, load_recipe
from quadsim.rotation import roll_pitch_from_quat

Array = NDArray[np.float64]
HERE = Path(__file__).parent
IMAGES, DATA = HERE / "img", HERE.parent / "data"
RATE = 200.0
BIAS = np.radians([4.1, -1.2, -1.6])
SHOWN = "10_undisturbed_slow_translation_A"
COMPARED = ("mahony", "eskf", "vqf", "att-snn", "att-snn-robust")
FLIGHTS = 4


def trials() -> list[Path]:
    """Files of the benchmark's trials."""
    found = sorted((Path(os.environ.get("QUADSIM_REALDATA", "realdata")) / "broad").glob("*.npz"))
    if not found:
        raise SystemExit("set QUADSIM_REALDATA to the folder that holds broad/")
    return found


def said(*arguments: str, last: int | None = None) -> str:
    """What a command prints, or its last lines."""
    lines = CliRunner().invoke(app, list(arguments)).stdout.rstrip().splitlines()
    return "\n".join(line.rstrip() for line in (lines if last is None else lines[-last:]))


def info(folder: Path) -> str:
    """`quadsim logs info` on a flight that has lost samples."""
    data = generate(flight_config(load_recipe("hummingbird")), 1, 20.0, folder / "x.zarr", seed=1, workers=1)
    csv = export(data, folder / "flight", "csv") / "flight_000" / "mav0" / "imu0" / "data.csv"
    rows = csv.read_text().splitlines(keepends=True)
    csv.write_text("".join(rows[:1000] + rows[1050:2000] + rows[2001:3000] + rows[3001:]))
    return said("logs", "info", str(folder / "flight")).replace(str(folder) + "/", "")


def resampling() -> list[str]:
    """How much of a tone is lost, or folds down."""
    lines = []
    for rate in (100.0, 200.0, 285.7, 500.0, 1000.0):
        cells = []
        for tone in (10.0, 60.0, 130.0, 190.0):
            if tone > 0.45 * rate:
                cells.append("–")
                continue
            time = np.arange(round(8 * rate)) / rate
            wave = np.sin(2 * np.pi * tone * time)[:, None] * np.ones(3)
            even, _ = resample(Recording("tone", "", time, wave, wave), RATE)
            grid, found = even["time"].to_numpy(), even["gyro"].to_numpy()[0, :, 0]
            expected = np.sin(2 * np.pi * tone * grid) if tone < 0.45 * RATE else 0.0
            off = np.sqrt(np.mean((found - expected)[200:-200] ** 2) * 2)
            cells.append(f"{100 * off:.2f} %")
        lines.append(f"| {rate:g} Hz | " + " | ".join(cells) + " |")
    return lines


def broad(logs: list) -> tuple[list[str], LogScores]:
    """Every estimator on the real trials."""
    scores = score_logs(logs, default_names())
    figure = draw_log(scores, SHOWN, (60.0, 100.0))
    save(figure, "broad.png")
    rows = [
        f"| {name} | {scores.mean(name, RAW):.2f} | {scores.mean(name, KNOWN):.2f} |"
        for name in scores.estimators
    ]
    return rows, scores


def calibration() -> list[str]:
    """An hour at rest of two sensors, calibrated."""
    lines = []
    steps = int(3600 * RATE)
    force = np.tile([0.0, 0.0, 9.81], (1, steps, 1))
    for preset in ("adis16448", "px4-mini"):
        imu = load_imu(preset)
        gyro, accel = simulate_imu(imu, np.zeros_like(force), force, RATE, seed=1)
        found = calibrate([Recording(preset, "", np.arange(steps) / RATE, gyro[0], accel[0])])
        if preset == "adis16448":
            save(draw(found), "calibration.png")
        for name, mine, true in (("gyro", found.gyro, imu.gyro), ("accel", found.accel, imu.accel)):
            tau = mine.time_constant / (true.time_constant or np.nan)
            lines.append(
                f"| {preset} | {name} | {mine.noise / true.noise:.3f} "
                f"| {mine.random_walk / true.random_walk:.2f} | {'' if mine.resolved else '> '}{tau:.2f} |"
            )
    return lines


def robust() -> list[str]:
    """Weights against filters on flights with good and bad sensors."""
    sets = [
        [flights("hummingbird", None, 3, FLIGHTS)],
        [flights("windy", None, 43, FLIGHTS)],
        [flights("windy", None, 43, FLIGHTS)],
        [
            flights("robust", v, 40 + k, FLIGHTS)
            for k, v in enumerate(("hummingbird", "px4-quad", "crazyflie"))
        ],
    ]
    lines = []
    for name in COMPARED:
        est = create(name)
        cells = []
        for k, each in enumerate(sets):
            errors = [rmse(est, path, BIAS if k == 2 else np.zeros(3)) for path in each]
            cells.append(f"{np.mean(errors):.2f}")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def flights(recipe: str, vehicle: str | None, seed: int, count: int) -> Path:
    """Flights that nothing is trained on; those of an earlier run if they are there."""
    chosen = load_recipe(recipe)
    if vehicle is not None:
        chosen = chosen.model_copy(update={"vehicle": vehicle})
    name = f"docs-{recipe}-{vehicle or chosen.vehicle}.zarr"
    return generate(flight_config(chosen), count, 100.0, DATA / name, seed=seed, workers=1)


def rmse(est, path: Path, bias: Array) -> float:
    """Inclination RMSE over the first flights of a dataset, after 3 s [deg]."""
    data = open_dataset(path).isel(flight=slice(FLIGHTS))
    gyro, accel, quat = (data[name].to_numpy().astype(float) for name in ("gyro", "accel", "quat"))
    truth = roll_pitch_from_quat(quat)
    error = inclination_error(run(est, gyro + bias, accel), truth)[:, round(3 * RATE) :]
    return float(np.sqrt(np.mean(error**2, axis=1)).mean())


def tuned(folder: Path) -> str:
    """Weights trained on, on the real trials."""
    said("logs", "convert", *map(str, trials()), "--out", str(folder / "broad.zarr"))
    arguments = ["--data", str(folder / "broad.zarr"), "--out", str(folder / "tuned")]
    return said("train", "--preset", "tune", "--init", "att-snn-robust", *arguments, last=2).replace(
        str(folder), "runs"
    )


def save(figure, name: str) -> None:
    """Line drawings need few colours: a fifth of the size."""
    figure.savefig(IMAGES / name, dpi=100)
    Image.open(IMAGES / name).convert("P", palette=Image.Palette.ADAPTIVE, colors=48).save(
        IMAGES / name, optimize=True
    )


def columns() -> str:
    """An example of a column map, read by the reader itself before it is shown."""
    return (HERE / "columns.toml").read_text().rstrip()


def main() -> None:
    """Measure everything and write the page."""
    matplotlib.rcParams.update(STYLE)
    logs = [read_log(path) for path in trials()]
    with tempfile.TemporaryDirectory() as drafts:
        folder = Path(drafts)
        values = {
            "info": info(folder),
            "resampling": "\n".join(resampling()),
            "columns": columns(),
            "broad": "\n".join(broad(logs)[0]),
            "broad_count": str(len(logs)),
            "calibration": "\n".join(calibration()),
            "robust": "\n".join(robust()),
            "robust_count": str(FLIGHTS),
            "tuned": tuned(folder),
        }
    page = (HERE / "logs.template.md").read_text()
    for name, text in values.items():
        page = page.replace(f"{{{name}}}", text)
    (HERE / "logs.md").write_text(page)


if __name__ == "__main__":
    main()
