"""Experiments: grids of scenarios, conditions and seeds, as TOML files in `scenarios/experiments`.

A design over axes is a Latin hypercube (McKay, Beckman & Conover 1979), optimised by SciPy to cover pairs of
axes evenly. Every level is flown equally often, and about equally often with every level of the other axes,
so that the mean over the flights of a level is its main effect.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field
from scipy.stats import qmc

from quadsim.config.ranges import Between
from quadsim.config.toml import Strict, load_toml, merged, nearest
from quadsim.flight.scenario import Scenario, changed, load_scenario, scenario_names
from quadsim.held_out import HeldOut, load_held_out, releases

FOLDER = "scenarios/experiments"
Levels = Mapping[str, str]
"""Level by axis."""
Knowledge = Literal["airframe", "initial attitude"]
"""Quantities other than readings that an estimator can be given."""


class Condition(Strict):
    """Levels of an axis for which the verdict has a separate clause."""

    name: str
    """Start of the clause's line, such as "With known drag"."""
    clause: str
    """End of the clause in the headline, such as "if the airframe's drag is known"."""
    axis: str
    levels: tuple[str, ...]


class Sweep(Strict):
    """A number of a scenario at several levels, to find the level at which flights crash."""

    unit: str = ""
    scenario: str
    """Shipped scenario that is changed."""
    fields: dict[str, Any]
    """Fields that replace those of the scenario, at level 1."""
    scaled: str
    """Path of the number or vector that is multiplied by the level, such as "faults.0.gyro_deg"."""
    levels: tuple[Annotated[float, Between(0.0, 1e6)], ...]
    """Levels in increasing order."""

    def at(self, level: float) -> Scenario:
        """Return the scenario at a level.

        Raises:
            ValueError: A value is not valid for its field.
        """
        fields: Any = deepcopy(self.fields)
        place = fields
        *path, last = (int(key) if key.isdecimal() else key for key in self.scaled.split("."))
        try:
            for key in path:
                place = place[key]
            place[last] = (level * np.array(place[last], np.float64)).tolist()
        except (KeyError, IndexError, TypeError, ValueError):
            raise ValueError(f'scaled = "{self.scaled}": names no number or vector of fields') from None
        return changed(load_scenario(self.scenario), fields)


class Experiment(Strict):
    """An experiment: scenarios, conditions and seeds."""

    description: str
    scenarios: tuple[str, ...] = ()
    """Shipped names or paths of scenarios; by default, all shipped ones."""
    seeds: Annotated[int, Between(1, 10_000)] = 10
    """Number of flights of each estimator in each scenario."""
    seed: Annotated[int, Between(0, 2**63 - 1)] | None = None
    """Seed of all random numbers, if the user cannot choose it."""
    axes: dict[str, dict[str, dict[str, Any]]] = Field(default_factory=dict)
    """Levels of each axis, and the fields of a scenario that they set; faults are added to those of the
    scenario."""
    combinations: Annotated[int, Between(0, 100_000)] = 0
    """Number of combinations of levels and scenarios."""
    conditions: tuple[Condition, ...] = ()
    always: str = ""
    """End of the headline if the same estimator is best in all conditions, such as "whether ... is known or
    not"."""
    sweeps: dict[str, Sweep] = Field(default_factory=dict)
    like: str = ""
    """Experiment from which axes and conditions are taken."""
    held_out: bool = False
    """Whether scenarios, seed and number of flights are those of a held-out suite."""
    release: str = ""
    """Release of the held-out suite; by default, the newest."""
    given: tuple[Knowledge, ...] | None = None
    """Quantities that estimators are given in every flight; None: as defined by each scenario."""

    def cases(self, scenarios: Sequence[str | Path] | None = None) -> "dict[str, Case]":
        """Return the cases by name, for the given scenarios or those of the experiment.

        Raises:
            ValueError: A scenario does not exist, a level does not fit, or two scenarios have the same name.
        """
        found = self._cases(scenarios)
        if self.given is not None:
            for name, case in found.items():
                start = {"known_attitude": "initial attitude" in self.given}
                given = {"vehicle_known": "airframe" in self.given, "start": start}
                scenario = changed(case.scenario, merged(case.scenario.model_dump(), given))
                found[name] = case._replace(scenario=scenario)
        return found

    def _cases(self, scenarios: Sequence[str | Path] | None) -> "dict[str, Case]":
        if self.held_out:
            if scenarios:
                raise ValueError("the held-out suite has scenarios of its own: leave --scenario out")
            return draw_scenarios(load_held_out(self.release), self.axes)
        if self.sweeps and scenarios is None:
            return {
                f"{name}={level:g}": Case(sweep.at(level), {name: f"{level:g} {sweep.unit}".rstrip()})
                for name, sweep in self.sweeps.items()
                for level in sweep.levels
            }
        sources = (self.scenarios or scenario_names()) if scenarios is None else scenarios
        if self.axes:
            return self._design(sources)
        found: dict[str, Case] = {}
        for source in sources:
            name = Path(source).name.removesuffix(".toml")
            if name in found:
                raise ValueError(f'two scenarios are called "{name}"; give one of the files another name')
            found[name] = Case(load_scenario(source), {})
        return found

    def _design(self, scenarios: Sequence[str | Path]) -> "dict[str, Case]":
        axes = {axis: list(levels) for axis, levels in self.axes.items()} | {"scenario": list(scenarios)}
        counts = np.array([len(levels) for levels in axes.values()])
        if self.combinations < counts.max():
            raise ValueError(f"combinations = {self.combinations}: an axis has {counts.max()} levels")
        sampler = qmc.LatinHypercube(len(axes), optimization="random-cd", rng=np.random.default_rng(0))
        places = np.floor(sampler.random(self.combinations) * counts).astype(int).tolist()
        width, found = len(str(self.combinations - 1)), {}
        for number, place in enumerate(places):
            levels = {axis: str(own[k]) for (axis, own), k in zip(axes.items(), place, strict=True)}
            base = load_scenario(levels["scenario"])
            found[f"axes-{number:0{width}}"] = Case(with_levels(base, levels, self.axes), levels)
        return found


class Case(NamedTuple):
    """A scenario of an experiment, with its levels."""

    scenario: Scenario
    levels: Levels  #: of each axis, "scenario" among them, or of a sweep; empty without any


SUITE = Experiment(description="Scenarios as they stand.")


def load_experiment(source: str | Path) -> Experiment:
    """Load an experiment by its shipped name or from a TOML file.

    Raises:
        ValueError: The file is invalid; the message names the key, its value and the allowed values.
    """
    found = load_toml(source, FOLDER, Experiment)
    update: dict[str, Any] = {}
    if found.like:
        other = load_experiment(found.like)
        update |= {key: getattr(other, key) for key in ("axes", "conditions", "always")}
    if found.held_out:
        found = of_release(found, found.release or releases()[-1])
    found = found.model_copy(update=update)
    for condition in found.conditions:
        axis = found.axes.get(condition.axis, {})
        if unknown := [level for level in condition.levels if level not in axis]:
            raise ValueError(
                f'{source}: condition "{condition.name}": the axis "{condition.axis}" has no level '
                f'"{unknown[0]}"; {nearest(unknown[0], axis)}'
            )
    return found


def of_release(experiment: Experiment, release: str) -> Experiment:
    """Return a held-out experiment with the suite of a release.

    Raises:
        ValueError: The release has no suite.
    """
    suite = load_held_out(release)
    return experiment.model_copy(update={"release": release, "seeds": suite.flights, "seed": suite.seed})


def with_levels(base: Scenario, levels: Levels, axes: Mapping[str, Mapping[str, Any]]) -> Scenario:
    """Return a scenario with the levels of axes; their faults are added to those of the scenario.

    Raises:
        ValueError: A level does not fit the scenario.
    """
    fields, said = base.model_dump(), []
    for axis, level in levels.items():
        if axis in axes:
            said.append(f"{axis}: {level}")
            sets = axes[axis][level]
            fields = merged(fields, {**sets, "faults": (*fields["faults"], *sets.get("faults", ()))})
    return changed(base, fields | {"description": f"{base.description.rstrip('.')}; {'; '.join(said)}."})


# --- the held-out suite ---------------------------------------------------------------------------

KINDS = ("hover", "figure of eight", "random manoeuvres")
DURATION_S = 20.0
HEIGHT_M = 12.0


def draw_scenarios(held_out: HeldOut, axes: Mapping[str, Mapping[str, Any]]) -> dict[str, Case]:
    """Draw the scenarios of a held-out suite, with their levels."""
    width = len(str(held_out.scenarios - 1))
    return {
        f"held-out-{k:0{width}}": _draw(held_out, [held_out.seed, k], axes) for k in range(held_out.scenarios)
    }


def _draw(held_out: HeldOut, seed: list[int], axes: Mapping[str, Mapping[str, Any]]) -> Case:
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(KINDS))
    levels = {axis: str(rng.choice(list(of_axis))) for axis, of_axis in axes.items()}
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
    base = changed(base, {"wind": air, "trajectory": trajectory})
    return Case(with_levels(base, levels, axes), levels | {"scenario": kind})


def _trajectory(kind: str, period_s: float, tilt_deg: float) -> dict[str, Any]:
    place = (0.0, 0.0, HEIGHT_M)
    if kind == "hover":
        return {"kind": "hover", "position": place}
    if kind == "figure of eight":
        eight = {"amplitude": (3.0, 1.5, 0.0), "ratio": (1, 2, 0), "period_s": period_s}
        return {"kind": "lissajous", "position": place, **eight}
    return {"kind": "mix", "position": place, "max_tilt_deg": tilt_deg, "min_tilt_deg": 0.5 * tilt_deg}
