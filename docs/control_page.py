"""Fly the spiking controllers beside the cascade: `python docs/pages.py control`.

A run that is cut short resumes, as `quadsim bench` does.
"""

from argparse import Namespace
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import ROOT, Part, Values, row

from estimators import create
from estimators.control.controller import SpikingController, make_controller
from estimators.loihi.chip import LIMITS
from estimators.networks.decay_profiles import share_profiles
from estimators.networks.forward import OnLoihi
from estimators.networks.network import silenced
from estimators.networks.weights_file import load_network, save_network
from quadsim.control.attitude_controller import AttitudeController, MakeController
from quadsim.flight.loop import FlightLoop
from quadsim.flight.scenario import changed, load_scenario, scenario_names
from quadsim.imu.spec import load_imu
from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.console import progress_bar
from quadsim.vehicle import GRAVITY, Vehicle, load_vehicle
from scenarios.bench.cell import FlightSettings, fly_cell
from scenarios.bench.controllers import controller_of
from scenarios.bench.results import Results
from scenarios.bench.runner import bench

Array = NDArray[np.float64]
OUT = ROOT / "reports" / "control"
SEEDS = 20
ESTIMATOR, SPIKING = "att-snn", "control-attitude"
SAME = f"{ROOT / 'docs' / 'cascade.py'}:Cascade"
"""The cascade's levels as a controller of set-points: it knows no trajectory to feed forward."""
TEACHER, BASE = "cascade, truth", "cascade, Att-SNN"
NAMES = {
    TEACHER: "truth",
    "cascade without trajectory, truth": f"truth @ {SAME}",
    "spiking, truth": f"truth @ {SPIKING}",
    BASE: ESTIMATOR,
    "spiking, Att-SNN": f"{ESTIMATOR} @ {SPIKING}",
}
ELSEWHERE = ("px4-quad", "crazyflie")
"""Airframes that no controller was trained on."""
NOMINAL = (
    "hover",
    "step",
    "figure-8",
    "wind-2",
    "wind-5",
    "wind-8",
    "dryden-light",
    "dryden-moderate",
    "wind-gust",
)
AGGRESSIVE = ("step-large", "racing")
STEP_DEG, STEP_S, STEP_FLIGHTS = 20.0, 1.2, 8
PROFILES = (32, 16)
COLOURS = ("#000000", "#009e73", "#7a7a7a", "#0072b2")


def cells(results: Results) -> dict[tuple[str, str], Any]:
    """Each row by its scenario and title."""
    titles = {name: title for title, name in NAMES.items()}
    return {(each.scenario, titles[each.estimator]): each for each in results.rows}


def shown(each: Any) -> str:
    """Tracking error, and crashes."""
    if each.attitude_deg is None:
        return f"– ✕{each.crashes}"
    return f"{each.attitude_deg:.2f}" + (f" ✕{each.crashes}" if each.crashes else "")


def scenario_rows(found: dict[tuple[str, str], Any]) -> Iterator[str]:
    """Tracking by scenario."""
    for scenario in scenario_names():
        yield row(scenario, *(shown(found[scenario, title]) for title in NAMES))


def tracking(found: dict[tuple[str, str], Any], title: str, scenarios: Sequence[str]) -> Array:
    """RMS tracking error in scenarios [°]; NaN where all crashed at once."""
    return np.array([found[s, title].attitude_deg or np.nan for s in scenarios], dtype=float)


def base_of(title: str) -> str:
    """The cascade on the same attitude."""
    return TEACHER if NAMES[title].startswith("truth") else BASE


def summary_rows(found: dict[tuple[str, str], Any]) -> Iterator[str]:
    """What the figures of merit are for each controller."""
    for title in NAMES:
        base = base_of(title)
        ratios = [
            tracking(found, title, NOMINAL) / tracking(found, other, NOMINAL) for other in (base, TEACHER)
        ]
        crashes = {name: [found[s, name].crashes or 0 for s in scenario_names()] for name in (title, base)}
        jitter = np.mean([found[s, title].jitter or np.nan for s in NOMINAL])
        yield row(
            title,
            *(f"{np.median(each):.2f} ({np.nanmin(each):.2f} to {np.nanmax(each):.2f})" for each in ratios),
            f"{np.nanmean(tracking(found, title, AGGRESSIVE)):.1f}",
            sum(crashes[title]),
            sum(max(ours - theirs, 0) for ours, theirs in zip(crashes[title], crashes[base], strict=True)),
            f"{jitter:.1f}",
        )


def elsewhere_rows() -> Iterator[str]:
    """Tracking on the truth with airframes of another size, and crashes."""
    titles = [title for title in NAMES if base_of(title) == TEACHER]
    for vehicle in ELSEWHERE:
        for name in ("hover", "step", "figure-8", "dryden-moderate"):
            scenario = changed(load_scenario(name), {"vehicle": vehicle})
            cells = [fly_cell(name, scenario, NAMES[title], FlightSettings(SEEDS)) for title in titles]
            found = Results(
                {name: scenario}, [cell.estimator for cell in cells], FlightSettings(SEEDS), cells
            )
            yield row(f"{vehicle}, {name}", *map(shown, found.rows))


def makers() -> dict[str, tuple[MakeController | None, Any]]:
    """Controller and estimator of each contender; None: the cascade's own, the truth.

    Without a trajectory to follow, the cascade that knows none is the cascade.
    """
    estimator = create(ESTIMATOR)
    return {
        title: (make_controller(controller_of(name)), estimator if base_of(title) == BASE else None)
        for title, name in NAMES.items()
        if controller_of(name) != SAME
    }


def step_response(make: MakeController | None, estimator: Any) -> Array:
    """Roll after a step of its set-point, (flights, T) [°]."""
    vehicle: Vehicle = load_vehicle("hummingbird")
    imu = load_imu("adis16448")
    loop = FlightLoop(vehicle, STEP_FLIGHTS, imu=imu, seed=5, estimator=estimator, controller=make)
    loop.reset(position=np.tile([0.0, 0.0, 50.0], (STEP_FLIGHTS, 1)))
    rest, steps = 400, round(STEP_S * 200)
    out = np.empty((STEP_FLIGHTS, steps))
    command = np.zeros((STEP_FLIGHTS, 4))
    command[:, 3] = GRAVITY
    for k in range(rest + steps):
        if k >= rest:
            command[:, 0] = np.radians(STEP_DEG)
            out[:, k - rest] = np.degrees(roll_pitch_from_quat(loop.plant.quat)[:, 0])
        loop.step("attitude", command)
    return out


def draw_steps(responses: dict[str, Array]) -> Figure:
    """Mean and range of the responses."""
    figure = Figure(figsize=(8.0, 3.8), layout="constrained")
    axes = figure.subplots()
    time = np.arange(round(STEP_S * 200)) / 200.0
    axes.axhline(STEP_DEG, color="0.3", lw=0.8, ls=":")
    for (title, response), colour in zip(responses.items(), COLOURS, strict=True):
        axes.fill_between(time, response.min(axis=0), response.max(axis=0), color=colour, alpha=0.15, lw=0)
        axes.plot(time, response.mean(axis=0), color=colour, label=title)
    axes.set_xlabel("time after the step [s]")
    axes.set_ylabel("roll [°]")
    axes.legend(loc="lower right")
    return figure


def step_rows(responses: dict[str, Array]) -> Iterator[str]:
    """Rise, overshoot and what is left."""
    for title, response in responses.items():
        mean = response.mean(axis=0)
        rise = np.argmax(mean > 0.9 * STEP_DEG) / 200.0 if (mean > 0.9 * STEP_DEG).any() else np.nan
        left = np.abs(mean[-40:] - STEP_DEG).mean()
        yield row(title, f"{rise:.2f}", f"{max(mean.max() / STEP_DEG - 1.0, 0.0):.0%}", f"{left:.1f}")


def chip_rows() -> Iterator[str]:
    """Cores of the chip that the controller takes, by its decay profiles."""
    config, tensors = load_network(SPIKING)
    for profiles in (None, *PROFILES):
        cores = OnLoihi(config, share_profiles(tensors, profiles) if profiles else tensors).cores
        bits = sum(core.used()["synaptic bits"] for core in cores) / LIMITS["synaptic bits"]
        yield row(f"{profiles}, shared" if profiles else "as trained", len(cores), f"{bits:.2f}")


def profile_rows() -> Iterator[str]:
    """What few decay profiles cost the controller."""
    config, tensors = load_network(SPIKING)
    names = {"as trained": f"truth @ {SPIKING}"}
    for profiles in PROFILES:
        file = OUT / f"profiles-{profiles}.safetensors"
        save_network(file, config, share_profiles(tensors, profiles))
        names[f"{profiles}, shared after the training"] = f"truth @ {file}"
    found = bench(NOMINAL, ["truth", *names.values()], OUT / "profiles", FlightSettings(SEEDS))
    tracked = {(each.scenario, each.estimator): each.attitude_deg or np.nan for each in found.rows}
    crashed = dict.fromkeys(found.estimators, 0)
    for each in found.rows:
        crashed[each.estimator] += each.crashes or 0
    for title, name in names.items():
        ratios = [tracked[each, name] / tracked[each, "truth"] for each in NOMINAL]
        ratio = f"{np.median(ratios):.2f} ({np.nanmin(ratios):.2f} to {np.nanmax(ratios):.2f})"
        yield row(title, ratio, crashed[name], crashed["truth"])


def silenced_left() -> str:
    """What remains of a step where the output weights are zero [°]."""
    config, tensors = load_network(SPIKING)

    def make(rate_hz: float, vehicle: Vehicle) -> AttitudeController:
        return SpikingController(config, silenced(config, tensors))

    return f"{np.abs(step_response(make, None)[:, -1] - STEP_DEG).mean():.0f}"


def values(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    OUT.mkdir(parents=True, exist_ok=True)
    with progress_bar("controllers", "cells") as progress:
        results = bench(scenario_names(), list(NAMES.values()), OUT, FlightSettings(SEEDS), progress=progress)
    found = cells(results)
    responses = {title: step_response(*made) for title, made in makers().items()}
    part.save(draw_steps(responses), "control-steps.png")
    return {
        "scenarios": list(scenario_rows(found)),
        "summary": list(summary_rows(found)),
        "steps": list(step_rows(responses)),
        "chip": list(chip_rows()),
        "profiles": list(profile_rows()),
        "silenced": silenced_left(),
        "neurons": " + ".join(str(getattr(load_network(SPIKING).config, n)) for n in ("encoding", "hidden")),
        "elsewhere": list(elsewhere_rows()),
        "columns": row("scenario", *NAMES),
        "ruler": row(*["---"] * (1 + len(NAMES))),
        "seeds": str(SEEDS),
        "flights": str(SEEDS * len(scenario_names())),
        "nominal": ", ".join(NOMINAL),
        "aggressive": ", ".join(AGGRESSIVE),
    }
