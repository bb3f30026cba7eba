"""Training of the circuit: Adam with a learning rate that falls, over streams that are drawn once.

A run's folder holds `config.json`, `log.csv`, `checkpoint.npz`, `best.safetensors` and `curve.png`. A run
that was stopped continues from its checkpoint and ends with the same weights.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimators.circuit.estimator import circuit_estimator
from estimators.circuit.file import CircuitConfig, load_circuit, save_circuit
from estimators.circuit.floats import run_floats, stepped
from estimators.circuit.parameters import LEARNT, OUTPUT, RATE_HZ, Parameters, untrained, with_quick_start
from estimators.metrics import absolute_error
from quadsim.dataset.figures import STYLE
from quadsim.runs.files import alone, save_figure, write_csv, write_whole
from quadsim.runs.fingerprint import code_digest
from quadsim.runs.record import commit

from ..data import load_training_flights
from .config import CircuitRun
from .gradient import begin, loss_and_gradient
from .streams import Streams, draw_streams, load_motion

Array = NDArray[np.float64]
STEP = {"take": 0.5, "read": 0.5, "learn": 0.1, "gate": 0.5, "level": 0.5, "onset": 0.5}
"""Factors of the learning rate; others 1."""
WARM_UP, BETA1, BETA2, SLOW = 20, 0.9, 0.99, 0.98
"""Updates over which the rate rises; decays of Adam's moments, and of the averaged weights."""
SAVE_EVERY = 500
DIVERGED = 50.0
"""Length of a vector at which an update is taken back."""
RANGE_QUANTILE, RANGE = 0.999, 0.9
"""The scale of a vector: this quantile of its components spikes in so many of the steps."""
NOISE = 1.0


@dataclass(frozen=True)
class Row:
    """A row of the log."""

    updates: int
    loss: float
    """Mean since the last row."""
    longest: float
    """Longest component of a vector."""
    seconds: float


@dataclass
class AdamState:
    """What a checkpoint saves: weights, Adam's moments, averaged weights and the log."""

    weights: Array
    first: Array
    second: Array
    slow: Array
    rows: list[Row]


Progress = Callable[[Row, CircuitRun], None]


class Trained(NamedTuple):
    """What a training ends with."""

    weights: Path
    errors: dict[str, float]
    """Mean absolute error of each validation set, on spikes [deg]."""
    before: dict[str, float]
    """The same of the circuit that the run continued."""


def train_circuit(run: CircuitRun, out: Path, progress: Progress | None = None) -> Trained:
    """Train a circuit, or continue a run that was stopped.

    Raises:
        ValueError: A dataset that cannot be used, or another run's folder.
        FileNotFoundError: A dataset is not there.
    """
    with alone(out):
        before = {name: validation_error(_first(run), name) for name in run.validation} if run.init else {}
        flights, hands = load_motion(run.data)
        steps = _steps_of(run, [*flights, *hands])
        _claim(run, out)
        rng = np.random.default_rng([run.seed, 0])
        streams = draw_streams(flights, hands, run, steps, rng)
        sizes = {"training_flights": sum(map(len, flights)) + sum(map(len, hands))}
        vehicles = sorted({vehicle for each in flights for vehicle in each.vehicles})
        del flights, hands
        weights = stream_weights(streams)
        state = _start(run, out)
        while len(state.rows) * SAVE_EVERY < run.updates:
            _some_updates(run, streams, weights, state)
            _save_checkpoint(out, state)
            write_csv(out / "log.csv", state.rows)
            if progress:
                progress(state.rows[-1], run)
        p = with_quick_start(scaled(_with(_first(run), state.slow), streams))
        errors = {name: validation_error(p, name) for name in run.validation}
        note = {"config": json.loads(run.model_dump_json()), "commit": commit(), "vehicles": vehicles} | sizes
        note |= {"validation_deg": {Path(name).stem: round(value, 3) for name, value in errors.items()}}
        file = out / "best.safetensors"
        save_circuit(file, CircuitConfig(vectors=run.vectors, gates=run.gates, training=note), p)
        save_figure(out / "curve.png", _curve(state.rows))
    return Trained(file, errors, before)


def _steps_of(run: CircuitRun, parts: list) -> int:
    for part in parts:
        if not np.isclose(part.rate_hz, RATE_HZ):
            raise ValueError(f"data at {part.rate_hz:g} Hz, a circuit is for {RATE_HZ:g} Hz")
    steps = round(run.window_s * RATE_HZ)
    shortest = min(part.gyro.shape[1] for part in parts)
    if steps > shortest:
        raise ValueError(f"window_s: {run.window_s:g}, but the shortest flight has {shortest / RATE_HZ:g} s")
    return steps


def _claim(run: CircuitRun, out: Path) -> None:
    """Make the folder this run's."""
    out.mkdir(parents=True, exist_ok=True)
    file, code = out / "config.json", code_digest("training.circuit.train")
    text = json.dumps({"run": json.loads(run.model_dump_json()), "code": code}, indent=2)
    if file.is_file() and file.read_text(encoding="utf-8") != text:
        raise ValueError(
            f"{out}: holds a run with another configuration or of other code, choose another folder"
        )
    write_whole(file, text)


def _first(run: CircuitRun) -> Parameters:
    if run.init:
        return load_circuit(run.init).parameters
    return untrained(run.vectors, run.gates, run.seed, NOISE)


def _flat(p: Parameters) -> Array:
    return np.concatenate([np.ravel(getattr(p, name)) for name in LEARNT])


def _with(p: Parameters, weights: Array) -> Parameters:
    """The circuit with other learnt parameters."""
    values, at = {}, 0
    for name in LEARNT:
        shape = getattr(p, name).shape
        size = int(np.prod(shape))
        values[name] = weights[at : at + size].reshape(shape)
        at += size
    return p._replace(**values)


def stream_weights(streams: Streams) -> NDArray[np.float32]:
    """Weights of the streams in the loss: 1 over half a degree more than the untrained circuit's error.

    So a calm flight counts as much as a tumbling one, relative to what is possible there.
    """
    p, errors = untrained(), []
    for first in range(0, len(streams.up), 64):
        batch = streams.batch(np.arange(first, min(first + 64, len(streams.up))))
        trace, senses = begin(p, batch)
        run_floats(batch.angle, batch.force, stepped(p), trace, senses)
        estimate = trace.x[1:, OUTPUT]
        cosine = (estimate * batch.up).sum(1) / np.linalg.norm(estimate, axis=1)
        errors.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean(0))
    weights = 1 / (np.concatenate(errors) + 0.5)
    return (weights / weights.mean()).astype(np.float32)


def _some_updates(run: CircuitRun, streams: Streams, weights: NDArray[np.float32], state: AdamState) -> None:
    """`SAVE_EVERY` updates, and a row of the log."""
    began, first = time.monotonic(), len(state.rows) * SAVE_EVERY
    last = min(first + SAVE_EVERY, run.updates)
    start = _first(run)
    factors = np.concatenate([np.full(getattr(start, name).size, STEP.get(name, 1.0)) for name in LEARNT])
    losses, longest = [], 0.0
    for k in range(first, last):
        rng = np.random.default_rng([run.seed, 1, k])
        rows = rng.choice(len(weights), min(run.batch_size, len(weights)), replace=False)
        p = _with(start, state.weights)
        loss, slope, trace = loss_and_gradient(p, streams.batch(rows), weights[rows])
        gradient, longest = _flat(slope), max(longest, float(np.abs(trace.x).max()))
        if not np.isfinite(loss) or not np.isfinite(gradient).all() or np.abs(trace.x).max() > DIVERGED:
            state.weights, state.first = state.slow.copy(), 0 * state.first
            continue
        gradient *= min(1.0, 1.0 / np.linalg.norm(gradient))
        state.first = BETA1 * state.first + (1 - BETA1) * gradient
        state.second = BETA2 * state.second + (1 - BETA2) * gradient**2
        rate = run.learning_rate * 0.5 * (1 + np.cos(np.pi * k / run.updates)) * min(1, (k + 1) / WARM_UP)
        mean = state.first / (1 - BETA1 ** (k + 1))
        size = np.sqrt(state.second / (1 - BETA2 ** (k + 1))) + 1e-7
        state.weights = state.weights - factors * rate * mean / size
        state.slow = SLOW * state.slow + (1 - SLOW) * state.weights
        losses.append(loss)
    seconds = state.rows[-1].seconds if state.rows else 0.0
    loss = float(np.mean(losses)) if losses else float("nan")
    state.rows.append(Row(last, loss, longest, seconds + time.monotonic() - began))


def scaled(p: Parameters, streams: Streams) -> Parameters:
    """The circuit with scales of its vectors from how long they are on streams."""
    batch = streams.batch(np.arange(min(128, len(streams.up))))
    trace, senses = begin(p, batch)
    run_floats(batch.angle, batch.force, stepped(p), trace, senses)
    size = np.abs(trace.x[1:]).transpose(1, 0, 2, 3).reshape(len(p.start), -1)
    return p._replace(scale=np.quantile(size, RANGE_QUANTILE, axis=1).astype(np.float64) / RANGE)


def validation_error(p: Parameters, path: str) -> float:
    """Mean absolute error on spikes over complete flights of a dataset, unknown initial attitude [deg]."""
    flights = load_training_flights([path])
    estimator = circuit_estimator("att-snn", p)
    estimator.reset(len(flights))
    return float(absolute_error(estimator.sequence(flights.gyro, flights.accel), flights.roll_pitch).mean())


def _start(run: CircuitRun, out: Path) -> AdamState:
    """The state of the folder's checkpoint, or a new one."""
    file = out / "checkpoint.npz"
    if file.is_file():
        with np.load(file, allow_pickle=False) as kept:
            rows = [Row(int(a), float(b), float(c), float(d)) for a, b, c, d in kept["rows"]]
            return AdamState(*(kept[name] for name in ("weights", "first", "second", "slow")), rows=rows)
    weights = _flat(_first(run))
    return AdamState(weights, 0 * weights, 0 * weights, weights.copy(), [])


def _save_checkpoint(out: Path, state: AdamState) -> None:
    rows = np.array([(row.updates, row.loss, row.longest, row.seconds) for row in state.rows])
    buffer = io.BytesIO()
    np.savez(
        buffer, weights=state.weights, first=state.first, second=state.second, slow=state.slow, rows=rows
    )
    write_whole(out / "checkpoint.npz", buffer.getvalue())


def _curve(rows: list[Row]) -> Figure:
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6, 3.5), layout="constrained")
        axes = figure.add_subplot()
        axes.plot([row.updates for row in rows], [np.degrees(row.loss) for row in rows])
        axes.set_xlabel("updates")
        axes.set_ylabel("weighted training error [deg]")
    return figure
