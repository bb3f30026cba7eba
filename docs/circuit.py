"""The spiking circuit that follows turns, part by part, at home and elsewhere."""

from argparse import Namespace
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from foreign import AIRFRAMES, foreign
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import Part, Values, row
from recordings import BROAD, PHANTOM4, recordings, score
from simulated import estimate_of, simulated

from estimators import create
from estimators.analysis.circuit import measure
from estimators.circuit.circuit_estimator import SCALING, Silent, circuit_estimator
from estimators.circuit.circuit_records import ANGLE_DIGITS, no_spikes, state_of
from estimators.circuit.file import load_circuit
from estimators.circuit.floats import new_trace, run_floats, stepped
from estimators.circuit.on_chip import place, populations
from estimators.circuit.parameters import GRAVITY, OUTPUT, RATE_HZ, Parameters, quantised, untrained
from estimators.circuit.spikes import SpikingCircuit, step
from estimators.evaluation.flights import Flights, load_flights
from estimators.evaluation.logs import RAW
from estimators.metrics import attitude_error
from estimators.networks.encoder import encode_sample
from estimators.networks.network import NetworkEstimator, zero_states
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.estimator import AttitudeEstimator
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed
from quadsim.runs.console import progress_bar

Array = NDArray[np.float64]
NAME = "att-snn"
FLIGHTS, DURATION_S = 6, 60.0
SETS = {
    "rough px4-quad": ("robust", {"vehicle": "px4-quad"}, 8601),
    "rough Crazyflie": ("robust", {"vehicle": "crazyflie"}, 8602),
    "turbulence, raw IMU": ("turbulent", {"imu": "raw"}, 8603),
    "steady wind": ("windy", {}, 8606),
    "any Crazyflie, raw IMU": ("wide", {"vehicle": "crazyflie", "imu": "raw"}, 8613),
    "carried": ("carried", {}, 8612),
    "in the hand": ("hand-held", {}, 8608),
    "tumbling": ("tumbling", {}, 8611),
}
"""New flights: recipe, what differs from it, and seed."""
SCALE = (1.33, 1.21, 0.56, 1.23)
"""Lengths of the untrained circuit's vectors, as `training.circuit.train.scaled` finds them."""
RESAMPLES = 4000
SHOWN = 8
"""Neurons of a kind in the raster, those that spike most."""


def spiking(p: Parameters, steps: int = 4) -> NetworkEstimator:
    """The circuit on spikes."""
    return circuit_estimator("att-snn", p, steps)


def held(p: Parameters, flights: Flights) -> Parameters:
    """The circuit whose gates, after their start, stay as open as they are on average."""
    trace, senses = new_trace(p, flights.gyro.shape[1], len(flights.gyro))
    angle, force = (
        np.ascontiguousarray(each.transpose(1, 2, 0), np.float32)
        for each in (flights.gyro / RATE_HZ, flights.accel / GRAVITY)
    )
    run_floats(angle, force, stepped(p), trace, senses)
    opened = np.clip(trace.opened, 0, 1).mean((0, 2))
    return p._replace(gate=0 * p.gate, level=opened.astype(np.float64), onset=p.onset + p.level - opened)


def estimators(home: Flights) -> dict[str, AttitudeEstimator]:
    """What the table compares, in the order of its columns."""
    config, p = load_circuit(NAME)
    first = untrained()._replace(scale=np.array(SCALE))
    return {
        "untrained, floats": circuit_estimator("att-rnn", first),
        "untrained, spikes": spiking(first),
        "gates held": spiking(held(p, home)),
        "floats": circuit_estimator("att-rnn", p),
        "spikes": spiking(p, config.steps_per_sample),
        "2 steps": spiking(p, 2),
        "1 step": spiking(p, 1),
        "silenced": NetworkEstimator(Silent(), RATE_HZ),
        "att-snn-paper": create("att-snn-paper"),
        "att-rnn-paper": create("att-rnn-paper"),
        "vqf": create("vqf"),
        "imm": create("imm"),
    }


def flight_errors(est: AttitudeEstimator, flights: Flights) -> Array:
    """Mean absolute error of roll and pitch of each flight, unknown initial attitude [deg]."""
    return attitude_error(estimate_of(est, flights), flights.truth).sequences


def domains(given: Namespace) -> dict[str, Callable[[Mapping[str, AttitudeEstimator]], dict[str, Array]]]:
    """For each row what scores all estimators: the errors of its flights or recordings."""

    def of(flights: Flights) -> Callable[[Mapping[str, AttitudeEstimator]], dict[str, Array]]:
        return lambda made: {name: flight_errors(est, flights) for name, est in made.items()}

    def recorded(name: str) -> Callable[[Mapping[str, AttitudeEstimator]], dict[str, Array]]:
        def errors(made: Mapping[str, AttitudeEstimator]) -> dict[str, Array]:
            table = score(name, sets[name], made).on_logs(RAW)
            return {each: table.loc[each].to_numpy() for each in made}

        return errors

    sets = recordings(given.recordings)
    found = {"Hummingbird": of(load_flights([simulated("test", given.data)]))}
    for name, (recipe, changes, seed) in SETS.items():
        path = given.data / f"circuit-{recipe}-{seed}.zarr"
        chosen = changed(load_recipe(recipe), changes)
        found[name] = of(load_flights([open_dataset(generate(chosen, FLIGHTS, DURATION_S, path, seed=seed))]))

    def rotorpy(made: Mapping[str, AttitudeEstimator]) -> dict[str, Array]:
        parts = [load_flights([foreign(airframe, given.data)]) for airframe in AIRFRAMES]
        return {
            name: np.concatenate([flight_errors(est, part) for part in parts]) for name, est in made.items()
        }

    return found | {"RotorPy": rotorpy, BROAD: recorded(BROAD), PHANTOM4: recorded(PHANTOM4)}


def interval(errors: Array) -> str:
    """95 % interval of the mean of flights, by the bootstrap."""
    rng = np.random.default_rng(0)
    means = rng.choice(errors, (RESAMPLES, len(errors))).mean(1)
    return "–".join(f"{each:.2f}" for each in np.quantile(means, (0.025, 0.975)))


def digits(n: int) -> Array:
    """Balanced ternary digits of a number of quanta, least first."""
    found = []
    for _ in range(ANGLE_DIGITS):
        found.append((n + 1) % 3 - 1)
        n = (n - found[-1]) // 3
    return np.array(found)


def turned() -> tuple[Array, Array, Array, dict[str, Array]]:
    """The circuit in a turn of 90° about the roll axis, after two seconds at rest.

    Returns:
        Time of the steps [s], rate [rad/s], and true and estimated roll (steps, 2) [rad]; and the signed
        spikes in every step: of the gyroscope's digits, of the estimate's vector, of innovations, of gates.
    """
    config, p = load_circuit(NAME)
    steps = config.steps_per_sample
    circuit = quantised(p, steps)
    core = SpikingCircuit(SCALING, circuit, OUTPUT, steps, p.scale[OUTPUT])
    numbers = zero_states(core, 1)[0]
    state = state_of(numbers, len(circuit.start), len(circuit.gate))
    state.x[2], state.gate[:] = circuit.start, circuit.levels[1]
    spikes = no_spikes(len(circuit.start), len(circuit.gate))
    t = np.arange(-2.0, 1.5, 1 / RATE_HZ)
    rate = np.where((t > 0.25) & (t < 0.75), np.pi, 0.0)
    roll = np.cumsum(rate) / RATE_HZ
    shown: dict[str, list[Array]] = {name: [] for name in ("gyroscope", "vector", "innovations", "gates")}
    estimated = []
    for k in range(len(t)):
        accel = GRAVITY * np.array([0.0, np.sin(roll[k]), np.cos(roll[k])])
        encode_sample(np.array([rate[k], 0.0, 0.0]), accel, SCALING, numbers)
        for _ in range(steps):
            step(numbers, state, circuit, steps, spikes)
            shown["gyroscope"].append(digits(int(spikes.angle[0])))
            shown["vector"].append(spikes.vectors[:, OUTPUT].copy())
            shown["innovations"].append(state.passed.T.ravel().copy())
            shown["gates"].append(spikes.gates.copy())
            estimated.append(np.arctan2(state.x[1, OUTPUT], state.x[2, OUTPUT]))
    fine = t[0] + np.arange(len(estimated)) / (steps * RATE_HZ)
    both = np.stack([np.repeat(roll, steps), estimated], 1)
    return fine, np.repeat(rate, steps), both, {name: np.array(each) for name, each in shown.items()}


def turn(part: Part) -> None:
    """Draw the spikes of a turn, one by one."""
    t, rate, roll, spikes = turned()
    figure = Figure(figsize=(9, 7), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(1, 5, 1.6))
    top.plot(t, np.degrees(rate))
    top.set_ylabel("roll rate\n[°/s]")
    labels = {
        "gyroscope": [f"roll rate × {3**k}" for k in range(ANGLE_DIGITS)],
        "vector": [f"up, {axis}" for axis in "xyz"],
        "innovations": [
            f"innovation {k // 3}, {'xyz'[k % 3]}" for k in range(spikes["innovations"].shape[1])
        ],
        "gates": [f"gate {k}" for k in range(spikes["gates"].shape[1])],
    }
    line, ticks = 0, {}
    for name, each in spikes.items():
        busiest = np.argsort(-np.abs(each[t > 0]).sum(0))[:SHOWN]
        for k in sorted(busiest):
            for sign, colour in ((1, "#0072b2"), (-1, "#d55e00")):
                when = t[each[:, k] == sign]
                middle.plot(when, np.full(when.size, line), "|", ms=5, mew=0.6, color=colour)
            ticks[line] = labels[name][k]
            line += 1
        line += 1
    middle.set_yticks(list(ticks), list(ticks.values()), fontsize=7)
    middle.invert_yaxis()
    bottom.plot(t, np.degrees(roll[:, 1]), label="estimated")
    bottom.plot(t, np.degrees(roll[:, 0]), "--", label="true")
    bottom.set(ylabel="roll [°]", xlabel="time [s]", xlim=(0, 1.2), ylim=(-15, 110))
    bottom.legend(frameon=False, loc="upper left")
    part.save(figure, "circuit-turn.png", dpi=120)


def neurons() -> list[str]:
    """The populations of the circuit that ships."""
    config, p = load_circuit(NAME)
    circuit = quantised(p, config.steps_per_sample)
    parts = populations(circuit)
    lines = [row(each.name, each.neurons, each.compartments, each.synapses) for each in parts]
    counts = [(each.neurons, each.compartments, each.synapses) for each in parts]
    total = np.sum(counts, 0).tolist()
    assert total[0] <= 1024, total
    assert place(circuit) <= 2
    return [*lines, row("all", *total)]


def spikes(data: Path) -> list[str]:
    """What the circuit does on the Hummingbird's test flights."""
    simulated("test", data)
    config, p = load_circuit(NAME)
    return [row(*each) for each in measure(config, p, [data / "test.zarr"]).summary()]


def by_steps(data: Path) -> list[str]:
    """The same with fewer steps a sample, which need fewer spikes."""
    config, p = load_circuit(NAME)
    rows = []
    for steps in (4, 2, 1):
        found = measure(config.model_copy(update={"steps_per_sample": steps}), p, [data / "test.zarr"])
        per_sample = found.nanojoules * steps
        rows.append(
            row(steps, f"{sum(found.spikes.values()):,.0f}", f"{per_sample:.0f}", f"{found.error_deg:.2f}")
        )
    return rows


def values(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    home = load_flights([simulated("train", given.data)], 8)
    made, rows, costs = estimators(home), [], {}
    sets = domains(given)
    with progress_bar("circuit", "sets") as bar:
        for k, (name, scored) in enumerate(sets.items()):
            bar(k, len(sets), name)
            errors = scored(made)
            cells = [f"{np.nanmean(errors[each]):.2f}" for each in made]
            rows.append(row(name, *cells, interval(errors["spikes"])))
            costs[name] = float(np.nanmean(errors["spikes"]) - np.nanmean(errors["floats"]))
    turn(part)
    worst = max(costs, key=lambda name: costs[name])
    training = load_circuit(NAME).config.training
    return {
        "columns": row("set", *made, "95 % of spikes"),
        "ruler": row(*["---"] * (len(made) + 2)),
        "table": rows,
        "neurons": neurons(),
        "spikes": spikes(given.data),
        "steps": by_steps(given.data),
        "worst": worst,
        "worst-cost": f"{costs[worst]:.2f}",
        "median-cost": f"{np.median(list(costs.values())):.2f}",
        "training-flights": str(training["training_flights"]),
    }
