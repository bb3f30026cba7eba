"""Fly the spiking controllers beside the cascade: `python docs/pages.py control`.

A run that is cut short resumes, as `quadsim bench` does.
"""

from argparse import Namespace
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from closed_loop import beside_crashes, fly_experiment
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import ROOT, Part, Row, Values

from estimators import create
from estimators.control.controller import SpikingController, make_controller
from estimators.loihi.chip import LIMITS
from estimators.networks.decay_profiles import share_profiles
from estimators.networks.forward import OnLoihi
from estimators.networks.network import silenced
from estimators.networks.weights_file import load_network, save_network
from quadsim.control.attitude_controller import MakeController
from quadsim.flight.loop import FlightLoop
from quadsim.imu.spec import load_imu
from quadsim.rotation import roll_pitch_from_quat
from quadsim.vehicle import GRAVITY, load_vehicle
from scenarios.bench.controllers import controller_of
from scenarios.bench.ranking import listed

Array = NDArray[np.float64]
OUT = ROOT / "reports" / "control"
SEEDS = 20
ESTIMATOR, SPIKING = "att-snn", "control-attitude"
TEACHER, BASE = "cascade, truth", "cascade, Att-SNN"
NAMES = {
    TEACHER: "truth",
    "spiking, truth": f"truth @ {SPIKING}",
    BASE: ESTIMATOR,
    "spiking, Att-SNN": f"{ESTIMATOR} @ {SPIKING}",
}
ELSEWHERE = ("px4-quad", "crazyflie")
"""Airframes that no controller was trained on."""
ABROAD = ("hover", "step", "figure-8", "dryden-moderate")
WINDS = ("wind-2", "wind-5", "wind-8", "dryden-light", "dryden-moderate", "wind-gust")
NOMINAL = ("hover", "step", "figure-8", *WINDS)
AGGRESSIVE = ("step-large", "racing")
STEP_DEG, STEP_S, STEP_FLIGHTS = 20.0, 1.2, 8
REST = 400
"""Samples before the step."""
PROFILES = (32, 16)
COLOURS = ("#000000", "#009e73", "#7a7a7a", "#0072b2")


def flown_metrics(folder: str, names: Sequence[str], **how: Any) -> pd.DataFrame:
    """Crashes and metrics by scenario and contender; numbers of which there is none are NaN."""
    results = fly_experiment(f"control-{folder}", names, seeds=SEEDS, **how)
    rows = pd.DataFrame(results.rows).set_index(["scenario", "estimator"])
    return rows[["attitude_deg", "jitter", "crashes"]].astype(float).fillna({"crashes": 0})


def tracking_table(rows: pd.DataFrame, titles: dict[str, str], heading: str) -> pd.DataFrame:
    """Tracking error [°] and crashes by scenario, under the titles of contenders."""
    cells = rows.apply(lambda each: beside_crashes(each.attitude_deg, each.crashes), axis="columns")
    scenarios = rows.index.get_level_values("scenario").unique()
    found = cells.unstack().loc[scenarios, list(titles.values())].set_axis(list(titles), axis="columns")
    return found.reset_index(names=heading)


def base_of(title: str) -> str:
    """The cascade on the same attitude."""
    return TEACHER if NAMES[title].startswith("truth") else BASE


def median_and_range(ratios: pd.Series) -> str:
    """Median and range."""
    return f"{ratios.median(skipna=False):.2f} ({ratios.min():.2f} to {ratios.max():.2f})"


def merit_rows(rows: pd.DataFrame) -> list[Row]:
    """The figures of merit of each controller."""
    tracking, jitter, crashes = (rows[key].unstack() for key in ("attitude_deg", "jitter", "crashes"))
    nominal, found = tracking.loc[list(NOMINAL)], []
    for title, name in NAMES.items():
        base = NAMES[base_of(title)]
        ratios = (median_and_range(nominal[name] / nominal[other]) for other in (base, NAMES[TEACHER]))
        aggressive = f"{tracking.loc[list(AGGRESSIVE), name].mean():.1f}"
        both = crashes[name].sum(), (crashes[name] - crashes[base]).clip(lower=0).sum()
        change = jitter.loc[list(NOMINAL), name].mean(skipna=False)
        found.append((title, *ratios, aggressive, *(f"{each:.0f}" for each in both), f"{change:.1f}"))
    return found


def other_airframes() -> pd.DataFrame:
    """Tracking on the truth with airframes of another size, and crashes."""
    titles = {title: name for title, name in NAMES.items() if base_of(title) == TEACHER}
    rows = [
        flown_metrics(vehicle, [*titles.values()], scenarios=ABROAD, changes={"vehicle": vehicle}).rename(
            f"{vehicle}, {{}}".format, level=0
        )
        for vehicle in ELSEWHERE
    ]
    return tracking_table(pd.concat(rows), titles, "airframe, scenario")


def step_response(make: MakeController | None, estimator: Any) -> Array:
    """Roll after a step of its set-point, (flights, T) [°]; None: the cascade's own, the truth."""
    vehicle, imu = load_vehicle("hummingbird"), load_imu("adis16448")
    loop = FlightLoop(vehicle, STEP_FLIGHTS, imu=imu, seed=5, estimator=estimator, controller=make)
    loop.reset(position=np.tile([0.0, 0.0, 50.0], (STEP_FLIGHTS, 1)))
    roll, command = [], np.tile([0.0, 0.0, 0.0, GRAVITY], (STEP_FLIGHTS, 1))
    for k in range(REST + round(STEP_S * 200)):
        command[:, 0] = np.radians(STEP_DEG) * (k >= REST)
        roll.append(np.degrees(roll_pitch_from_quat(loop.plant.quat)[:, 0]))
        loop.step("attitude", command)
    return np.stack(roll[REST:], axis=1)


def steps(part: Part) -> list[Row]:
    """Rise, overshoot and remaining error after a step of the set-point; draws mean and range of roll."""
    estimators = {TEACHER: None, BASE: create(ESTIMATOR)}
    figure = Figure(figsize=(8.0, 3.8), layout="constrained")
    axes, rows = figure.subplots(), []
    axes.axhline(STEP_DEG, color="0.3", lw=0.8, ls=":")
    for (title, name), colour in zip(NAMES.items(), COLOURS, strict=True):
        response = step_response(make_controller(controller_of(name)), estimators[base_of(title)])
        mean, time = response.mean(axis=0), np.arange(response.shape[1]) / 200.0
        axes.fill_between(time, response.min(axis=0), response.max(axis=0), color=colour, alpha=0.15, lw=0)
        axes.plot(time, mean, color=colour, label=title)
        risen = mean > 0.9 * STEP_DEG
        rise = np.argmax(risen) / 200.0 if risen.any() else np.nan
        left = f"{np.abs(mean[-40:] - STEP_DEG).mean():.1f}"
        rows.append((title, rise, f"{100 * max(mean.max() / STEP_DEG - 1.0, 0.0):.0f} %", left))
    axes.set(xlabel="time after the step [s]", ylabel="roll [°]")
    axes.legend(loc="lower right")
    part.save(figure, "control-steps.png")
    return rows


def with_profiles() -> list[Row]:
    """What few decay profiles save of the chip, and cost the controller; 0 profiles are those it has."""
    config, tensors = load_network(SPIKING)
    networks = {0: tensors} | {k: share_profiles(tensors, k) for k in PROFILES}
    names = {k: f"truth @ {OUT / f'profiles-{k}.safetensors'}" for k in networks}
    for k, each in networks.items():
        save_network(OUT / f"profiles-{k}.safetensors", config, each)
    flights = flown_metrics("profiles", ["truth", *names.values()], scenarios=NOMINAL)
    tracking, crashes = flights["attitude_deg"].unstack(), flights["crashes"].unstack().sum()
    rows = []
    for k, name in names.items():
        cores = OnLoihi(config, networks[k]).cores
        bits = sum(core.used()["synaptic bits"] for core in cores) / LIMITS["synaptic bits"]
        ratios = median_and_range(tracking[name] / tracking["truth"])
        both = f"{crashes[name]:.0f}", f"{crashes['truth']:.0f}"
        rows.append(
            (f"{k}, shared after the training" if k else "as trained", len(cores), bits, ratios, *both)
        )
    return rows


def controllers(part: Part, given: Namespace) -> Values:
    """Fly every contender, and draw their steps."""
    OUT.mkdir(parents=True, exist_ok=True)
    rows = flown_metrics("suite", list(NAMES.values()))
    config, tensors = load_network(SPIKING)
    silent = SpikingController(config, silenced(config, tensors))
    left = step_response(lambda *_: silent, None)[:, -1] - STEP_DEG
    return {
        "scenarios": tracking_table(rows, NAMES, "scenario"),
        "summary": merit_rows(rows),
        "steps": steps(part),
        "profiles": with_profiles(),
        "silenced": f"{np.abs(left).mean():.0f}",
        "neurons": f"{config.encoding} + {config.hidden}",
        "elsewhere": other_airframes(),
        "flights": str(SEEDS * len(rows) // len(NAMES)),
        "seeds": str(SEEDS),
        "nominal": listed(NOMINAL),
        "aggressive": listed(AGGRESSIVE),
    }
