"""The held-out suite: scenarios that are drawn, and that nobody looked at while anything was tuned."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadsim.flight.scenario import Scenario, changed
from quadsim.held_out import HeldOut

from .axes import AXES, HELD_OUT, Combination, with_levels

KINDS = ("hover", "figure of eight", "random manoeuvres")
DURATION_S = 20.0
HEIGHT_M = 12.0


def suite(held_out: HeldOut) -> dict[str, tuple[Combination, Scenario]]:
    """The scenarios by name, with their level of each axis; their kind of flight stands as the scenario."""
    width = len(str(held_out.scenarios - 1))
    drawn = (
        _draw(f"{HELD_OUT}{k:0{width}}", held_out, [held_out.seed, k]) for k in range(held_out.scenarios)
    )
    return {combination.name: (combination, scenario) for combination, scenario in drawn}


def _draw(name: str, held_out: HeldOut, seed: list[int]) -> tuple[Combination, Scenario]:
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(KINDS))
    levels = {axis: str(rng.choice(list(of_axis))) for axis, of_axis in AXES.items()}
    course, wind = rng.uniform(-np.pi, np.pi), rng.uniform(*held_out.wind)
    air: list[dict[str, Any]] = [
        {"kind": "constant", "velocity": (wind * np.cos(course), wind * np.sin(course), 0.0)}
    ]
    strength = rng.uniform(*held_out.wind_20ft)
    if rng.random() < 0.5:
        turbulence = {"airspeed": max(wind, 1.0), "altitude": HEIGHT_M, "wind_20ft": strength}
        air.append({"kind": "dryden", **turbulence})
    trajectory = _trajectory(kind, rng.uniform(*held_out.period_s), rng.uniform(*held_out.tilt_deg))
    base = Scenario(
        description=f"{kind}; wind of {wind:.1f} m/s{', turbulent' if len(air) > 1 else ''}",
        duration_s=DURATION_S,
        external="motion-capture",
    )
    combination = Combination(name, kind, levels)
    return combination, with_levels(changed(base, {"wind": air, "trajectory": trajectory}), levels)


def _trajectory(kind: str, period_s: float, tilt_deg: float) -> dict[str, Any]:
    place = (0.0, 0.0, HEIGHT_M)
    if kind == "hover":
        return {"kind": "hover", "position": place}
    if kind == "figure of eight":
        eight = {"amplitude": (3.0, 1.5, 0.0), "ratio": (1, 2, 0), "period_s": period_s}
        return {"kind": "lissajous", "position": place, **eight}
    return {"kind": "mix", "position": place, "max_tilt_deg": tilt_deg, "min_tilt_deg": 0.5 * tilt_deg}
