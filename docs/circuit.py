"""The spiking circuit that follows turns, part by part, at home and elsewhere."""

from argparse import Namespace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from errors import on_flights, on_recordings
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import Part, Row, Values, span
from simulated import Generated, foreign, simulated

from estimators.analysis.circuit import measure
from estimators.circuit.circuit_estimator import SCALING, Silent, circuit_estimator
from estimators.circuit.circuit_records import ANGLE_DIGITS, no_spikes, state_of
from estimators.circuit.file import CircuitConfig, load_circuit
from estimators.circuit.floats import new_trace, run_floats, stepped
from estimators.circuit.on_chip import place, populations
from estimators.circuit.parameters import GRAVITY, OUTPUT, RATE_HZ, Parameters, quantised, untrained
from estimators.circuit.spikes import SpikingCircuit, step
from estimators.evaluation.comparison import made_of
from estimators.evaluation.flights import Flights, load_flights
from estimators.evaluation.logs import RAW
from estimators.metrics import Summary
from estimators.networks.encoder import encode_sample
from estimators.networks.network import NetworkEstimator, zero_states
from quadsim.estimator import AttitudeEstimator
from quadsim.runs.console import progress_bar
from quadsim.runs.fingerprint import ASSETS

Array = NDArray[np.float64]
NAME = "att-snn"
FLIGHTS, DURATION_S = 6, 60.0
TUMBLING = {
    "rate_deg_s": (120.0, 350.0),
    "acceleration": (0.5, 12.0),
    "move_s": (3.0, 20.0),
    "rest_s": (0.5, 10.0),
}
"""A hand that turns an IMU at 10 rad/s and more, and shakes it hard."""
CRAZYFLIE = {"vehicle": "crazyflie"}
SETS = {
    "px4-quad, wind, rough IMU": ("robust", {"vehicle": "px4-quad"}, 8601),
    "Crazyflie, wind, rough IMU": ("robust", CRAZYFLIE, 8602),
    "turbulence, uncalibrated IMU": ("turbulent", {"imu": "raw"}, 8603),
    "Crazyflie of any mass and drag, uncalibrated IMU": ("wide", CRAZYFLIE | {"imu": "raw"}, 8613),
    "hand-held, any attitude": ("hand-held", {}, 8608),
    "hand-held, tumbling": ("hand-held", {"hand_held": TUMBLING}, 8611),
}
"""New flights: recipe, what differs from it, and seed."""
SCALE = (1.33, 1.21, 0.56, 1.23)
"""Lengths of the untrained circuit's vectors, as `training.circuit.train.scaled` finds them."""
FLOATS, SPIKES = "trained, floats", "trained, spikes"
"""Columns of the trained circuit; the spikes ship."""
GATE_INPUTS = "gate inputs"
"""What the code calls felt: the signals that open a gate."""
OTHERS = {
    "seed 2": "seed-2",
    "seed 3": "seed-3",
    "4 vectors, 8 gates": "4-vectors-8-gates",
    "4 vectors, 16 gates": "4-vectors-16-gates",
    "5 vectors, 12 gates": "5-vectors-12-gates",
}
"""Other circuits of the same training, and their files in assets/weights/circuits/."""
FEWER = {"2 steps per sample": 2, "1 step per sample": 1}
"""Of the circuit that ships."""
FRONT = {"Hummingbird": "o", "RotorPy": "s", "BROAD, real": "^", "Phantom 4, real": "D"}
"""Sets whose errors are drawn against neurons and spikes."""
SHOWN = 8
"""Neurons of a kind in the raster, those that spike most."""


def held(p: Parameters, flights: Flights) -> Parameters:
    """The circuit whose gates, after their start, stay as open as they are on average."""
    trace, senses = new_trace(p, flights.gyro.shape[1], len(flights.gyro))
    angle, force = (
        np.ascontiguousarray(each.transpose(1, 2, 0), np.float32)
        for each in (flights.gyro / RATE_HZ, flights.accel / GRAVITY)
    )
    run_floats(angle, force, np.zeros(angle[:, 0].shape, np.bool_), stepped(p), trace, senses)
    opened = np.clip(trace.opened, 0, 1).mean((0, 2))
    return p._replace(gate=0 * p.gate, level=opened.astype(np.float64), onset=p.onset + p.level - opened)


def circuits() -> dict[str, tuple[CircuitConfig, Parameters]]:
    """The circuit that ships, and those of other seeds and sizes."""
    folder = ASSETS / "weights" / "circuits"
    return {SPIKES: load_circuit(NAME)} | {
        name: load_circuit(folder / f"{file}.safetensors") for name, file in OTHERS.items()
    }


def compared(home: Flights) -> dict[str, AttitudeEstimator]:
    """What the table compares, in the order of its columns."""
    config, p = load_circuit(NAME)
    first = untrained()._replace(scale=np.array(SCALE))
    spiking = partial(circuit_estimator, NAME)
    return {
        "untrained, floats": circuit_estimator("att-rnn", first),
        "untrained, spikes": spiking(first, 4),
        "trained, gates fixed": spiking(held(p, home), 4),
        FLOATS: circuit_estimator("att-rnn", p),
        SPIKES: spiking(p, config.steps_per_sample),
        **{name: spiking(p, steps) for name, steps in FEWER.items()},
        "silenced: always level": NetworkEstimator(Silent(), RATE_HZ),
        **made_of(["att-snn-paper", "att-rnn-paper", "vqf", "imm"], RATE_HZ),
        **{name: spiking(p, config.steps_per_sample) for name, (config, p) in circuits().items()},
    }


def errors_by_set(given: Namespace) -> dict[str, pd.DataFrame]:
    """Error of each flight or recording of each set, estimators × flights [deg]."""
    made = compared(load_flights([simulated("train", given.data)], 8))
    sets = {"Hummingbird": [simulated("test", given.data)]}
    for name, (recipe, changes, seed) in SETS.items():
        path = given.data / f"circuit-{recipe}-{seed}.zarr"
        sets[name] = [Generated(recipe, FLIGHTS, seed, changes, DURATION_S).at(path)]
    sets["RotorPy"] = foreign(given.data)
    found = {}
    with progress_bar("circuit", "sets") as bar:
        for k, (name, flights) in enumerate(sets.items()):
            bar(k, len(sets), name)
            errors = on_flights(lambda _: made, flights).sequences.droplevel("initial")
            found[name] = pd.DataFrame(errors.to_list(), errors.index)
    scores = on_recordings(made, given.recordings)
    found |= {f"{name}, real": each.on_logs(RAW) for name, each in scores.items()}
    return {name: each.loc[list(made)] for name, each in found.items()}


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
    powers = 3 ** np.arange(ANGLE_DIGITS)  # of balanced ternary digits, whose sum is the number of all ones
    shown: dict[str, list[Array]] = {name: [] for name in ("gyroscope", "vector", "innovations", "gates")}
    estimated = []
    for k in range(len(t)):
        accel = GRAVITY * np.array([0.0, np.sin(roll[k]), np.cos(roll[k])])
        encode_sample(np.array([rate[k], 0.0, 0.0]), accel, SCALING, numbers)
        for _ in range(steps):
            step(numbers, state, circuit, steps, spikes)
            shown["gyroscope"].append((int(spikes.angle[0]) + powers.sum()) // powers % 3 - 1)
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


def neurons() -> list[Row]:
    """The populations of the circuit that ships."""
    config, p = load_circuit(NAME)
    circuit = quantised(p, config.steps_per_sample)
    rows = [
        (each.name.replace("what is felt", GATE_INPUTS), each.neurons, each.compartments, each.synapses)
        for each in populations(circuit)
    ]
    total = np.sum([counts for _, *counts in rows], 0).tolist()
    assert total[0] <= 1024, total
    assert place(circuit) <= 2
    return [*rows, ("all", *total)]


def by_steps(data: Path) -> tuple[list[Row], list[Row]]:
    """What the circuit does on the Hummingbird's test flights, and with fewer steps and spikes per sample."""
    simulated("test", data)
    config, p = load_circuit(NAME)
    found = {
        steps: measure(config.model_copy(update={"steps_per_sample": steps}), p, [data / "test.zarr"])
        for steps in (4, 2, 1)
    }
    rows = [
        (n, f"{sum(each.spikes.values()):,.0f}", f"{each.nanojoules * n:.0f}", each.error_deg)
        for n, each in found.items()
    ]
    shipped = found[config.steps_per_sample].summary()
    return [(kind.replace("felt", GATE_INPUTS), amount) for kind, amount in shipped], rows


def front(part: Part, data: Path, means: pd.DataFrame) -> list[Row]:
    """Errors of other seeds and sizes against what they need on a chip: a table, and a picture.

    The picture of spikes has the circuit that ships with fewer steps per sample as well.
    """
    config, p = load_circuit(NAME)
    fewer = {name: (config.model_copy(update={"steps_per_sample": n}), p) for name, n in FEWER.items()}
    neurons, spikes = {}, {}
    for name, (config, p) in (circuits() | fewer).items():
        neurons[name] = sum(each.neurons for each in populations(quantised(p, config.steps_per_sample)))
        spikes[name] = sum(measure(config, p, [data / "test.zarr"]).spikes.values())
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for column, marker in FRONT.items():
        error = means.loc[column]
        left.plot([*neurons.values()][: len(circuits())], error[list(circuits())], marker, alpha=0.8)
        right.plot([*spikes.values()], error[list(spikes)], marker, alpha=0.8, label=column)
    left.set(xlabel="neurons", ylabel="error [°]", ylim=(0, None))
    right.set(xlabel="spikes per second")
    right.set_xlim(0)
    right.legend(frameon=False, loc="lower left")
    part.save(figure, "circuit-front.png", dpi=120)
    return [
        (name.replace(SPIKES, "seed 1, ships"), neurons[name], f"{spikes[name]:,.0f}", *means[name])
        for name in circuits()
    ]


def circuit(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    errors = errors_by_set(given)
    every = pd.DataFrame({name: each.mean(axis=1) for name, each in errors.items()}).T
    means = every.drop(columns=list(OTHERS))
    ends = [Summary(each.loc[SPIKES].to_numpy(float)).mean_interval() for each in errors.values()]
    costs = means[SPIKES] - means[FLOATS]
    turn(part)
    spikes, steps = by_steps(given.data)
    return {
        "errors": means.assign(**{f"95 % interval of {SPIKES}": [span(*each) for each in ends]}).reset_index(
            names="flights or recordings"
        ),
        "front": front(part, given.data, every),
        "neurons": neurons(),
        "spikes": spikes,
        "steps": steps,
        "worst": str(costs.idxmax()),
        "worst-cost": f"{costs.max():.2f}",
        "median-cost": f"{costs.median():z.2f}",
        "training-flights": str(load_circuit(NAME).config.training["training_flights"]),
    }
