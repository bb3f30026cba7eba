"""The spiking circuit that follows turns, part by part, at home and elsewhere."""

from argparse import Namespace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from errors import on_flights, on_recordings
from matplotlib.figure import Figure
from pages import Part, Row, Values, span
from simulated import Generated, rotorpy_sets, simulated

from estimators import run
from estimators.analysis.circuit import measure_datasets
from estimators.analysis.raster import spikes_of
from estimators.circuit.circuit_estimator import Silent, circuit_estimator
from estimators.circuit.file import CircuitConfig, load_circuit
from estimators.circuit.floats import new_trace, run_floats, stepped
from estimators.circuit.on_chip import place, populations
from estimators.circuit.parameters import GRAVITY, OUTPUT, RATE_HZ, Parameters, quantised, untrained
from estimators.evaluation.comparison import made_of
from estimators.evaluation.flights import Flights, load_flights
from estimators.evaluation.logs import RAW
from estimators.metrics import Summary
from estimators.networks.network import NetworkEstimator
from quadsim.estimator import AttitudeEstimator
from quadsim.runs.fingerprint import ASSETS

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
"""Lengths of the untrained circuit's vectors, as `training.circuit.train.scale_vectors` finds them."""
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
SHOWN = 8
"""Neurons of a kind in the raster, those that spike most."""
SIGNS = ("#0072b2", "#d55e00")
"""Colours of positive and of negative spikes."""


def held_gates(p: Parameters, flights: Flights) -> Parameters:
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


def compared_circuits(home: Flights) -> dict[str, AttitudeEstimator]:
    """What the table compares, in the order of its columns."""
    config, p = load_circuit(NAME)
    first = untrained()._replace(scale=np.array(SCALE))
    spiking = partial(circuit_estimator, NAME)
    return {
        "untrained, floats": circuit_estimator("att-rnn", first),
        "untrained, spikes": spiking(first, 4),
        "trained, gates fixed": spiking(held_gates(p, home), 4),
        FLOATS: circuit_estimator("att-rnn", p),
        SPIKES: spiking(p, config.steps_per_sample),
        **{name: spiking(p, steps) for name, steps in FEWER.items()},
        "silenced: always level": NetworkEstimator(Silent(), RATE_HZ),
        **made_of(["att-snn-paper", "att-rnn-paper", "vqf", "imm"], RATE_HZ),
        **{name: spiking(p, config.steps_per_sample) for name, (config, p) in circuits().items()},
    }


def errors_by_set(given: Namespace) -> dict[str, pd.DataFrame]:
    """Error of each flight or recording of each set, estimators × flights [deg]."""
    made = compared_circuits(load_flights([simulated("train", given.data)], 8))
    sets = {"Hummingbird": [simulated("test", given.data)]}
    for name, (recipe, changes, seed) in SETS.items():
        path = given.data / f"circuit-{recipe}-{seed}.zarr"
        sets[name] = [Generated(recipe, FLIGHTS, seed, changes, DURATION_S).at(path)]
    sets["RotorPy"] = rotorpy_sets(given.data)
    found = {}
    for name, flights in sets.items():
        errors = on_flights(lambda _: made, flights).sequences.droplevel("initial")
        found[name] = pd.DataFrame(errors.to_list(), errors.index)
    scores = on_recordings(made, given.recordings)
    found |= {f"{name}, real": each.on_logs(RAW) for name, each in scores.items()}
    return {name: each.loc[list(made)] for name, each in found.items()}


def turn(part: Part) -> None:
    """Draw the spikes of a turn of 90° about the roll axis at 180 °/s, after two seconds at rest."""
    config, p = load_circuit(NAME)
    t = np.arange(-2.0, 1.5, 1 / RATE_HZ)
    rate = np.where((t > 0.25) & (t < 0.75), np.pi, 0.0)
    roll, zero = np.cumsum(rate) / RATE_HZ, np.zeros_like(t)
    gyro = np.stack([rate, zero, zero], 1)
    accel = GRAVITY * np.stack([zero, np.sin(roll), np.cos(roll)], 1)
    estimator = circuit_estimator(NAME, p, config.steps_per_sample)
    estimated = run(estimator, gyro[None], accel[None])[0, :, 0]
    spikes = spikes_of(estimator, gyro, accel)
    vectors, gates = len(p.scale), len(p.level)
    axes = [*enumerate("xyz")]
    labels = {
        "vectors": {k * vectors + OUTPUT: f"up, {axis}" for k, axis in axes},
        "innovations": {
            k * gates + gate: f"innovation {gate}, {axis}" for gate in range(gates) for k, axis in axes
        },
        "gates": {gate: f"gate {gate}" for gate in range(gates)},
    }
    figure = Figure(figsize=(9, 7), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(1, 5, 1.6))
    top.plot(t, np.degrees(rate))
    top.set_ylabel("roll rate\n[°/s]")
    line, ticks = 0, {}
    for name, neurons in labels.items():
        when, signed = spikes[name].time + t[0], spikes[name].neuron * (2 if name == "gates" else 1)
        counts = np.bincount(signed[when > 0] // 2, minlength=3 * gates)
        busiest = sorted(neurons, key=lambda k, counts=counts: -counts[k])[:SHOWN]
        for k in (k for k in neurons if k in busiest):
            trains = [when[signed == 2 * k + negative] for negative in (0, 1)]
            middle.eventplot(trains, lineoffsets=[line] * 2, colors=SIGNS, linelengths=0.7, linewidths=0.6)
            ticks[line] = neurons[k]
            line += 1
        line += 1
    middle.set_yticks(list(ticks), list(ticks.values()), fontsize=7)
    middle.invert_yaxis()
    bottom.plot(t, np.degrees(estimated), label="estimated")
    bottom.plot(t, np.degrees(roll), "--", label="true")
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
    config, p = load_circuit(NAME)
    found = {
        steps: measure_datasets(
            config.model_copy(update={"steps_per_sample": steps}), p, [data / "test.zarr"]
        )
        for steps in (4, 2, 1)
    }
    rows = [
        (n, f"{sum(each.spikes.values()):,.0f}", f"{each.nanojoules * n:.0f}", each.error_deg)
        for n, each in found.items()
    ]
    shipped = found[config.steps_per_sample].summary()
    return [(kind.replace("felt", GATE_INPUTS), amount) for kind, amount in shipped], rows


def sizes(data: Path, means: pd.DataFrame) -> list[Row]:
    """Neurons, spikes per second and errors of the circuits of other seeds and sizes."""
    rows = []
    for name, (config, p) in circuits().items():
        neurons = sum(each.neurons for each in populations(quantised(p, config.steps_per_sample)))
        spikes = sum(measure_datasets(config, p, [data / "test.zarr"]).spikes.values())
        rows.append((name.replace(SPIKES, "seed 1, ships"), neurons, f"{spikes:,.0f}", *means[name]))
    return rows


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
        "sizes": sizes(given.data, every),
        "neurons": neurons(),
        "spikes": spikes,
        "steps": steps,
        "worst": str(costs.idxmax()),
        "worst-cost": f"{costs.max():.2f}",
        "median-cost": f"{costs.median():z.2f}",
        "training-flights": str(load_circuit(NAME).config.training["training_flights"]),
    }
