"""Training of the circuit by Adam with a decreasing learning rate, on streams that are drawn once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from estimators.circuit.circuit_estimator import circuit_estimator
from estimators.circuit.file import CircuitConfig, load_circuit, save_circuit
from estimators.circuit.parameters import LEARNT, RATE_HZ, Parameters, untrained
from estimators.metrics import absolute_error

from ..config import EPOCH_UPDATES, CircuitRun
from ..data import TrainingFlights, load_training_flights
from ..run_folder import Epoch
from .gradient import cosine, loss_and_gradient, run_streams
from .start import as_flown
from .streams import Streams, draw_streams

Array = NDArray[np.float64]
STEP = {"take": 0.5, "read": 0.5, "learn": 0.1, "gate": 0.5, "level": 0.5, "onset": 0.5, "resume": 0.5}
"""Factors of the learning rate by parameter; the default is 1."""
WARM_UP, BETA1, BETA2, SLOW = 20, 0.9, 0.99, 0.98
"""Updates over which the learning rate rises; decays of Adam's moments and of the averaged weights."""
DIVERGED = 50.0
"""Length of a vector at which an update is undone."""
RANGE_QUANTILE, RANGE = 0.999, 0.9
"""Scale of a vector: the quantile of its components, and the share of steps in which this quantile spikes."""
NOISE = 1.0


class CircuitLearner:
    """Training of a circuit, with the methods of `training.epochs.Training`.

    Args:
        config: Configuration of the run.

    Raises:
        ValueError: A dataset is invalid.
        FileNotFoundError: A dataset does not exist.
    """

    def __init__(self, config: CircuitRun) -> None:
        self.config = config
        self.parts = [load_training_flights([path]) for path in config.data]
        for part in self.parts:
            if not np.isclose(part.rate_hz, RATE_HZ):
                raise ValueError(f"data at {part.rate_hz:g} Hz, a circuit is for {RATE_HZ:g} Hz")
        self.steps = round(config.window_s * RATE_HZ)
        shortest = min(part.gyro.shape[1] for part in self.parts)
        if self.steps > shortest:
            raise ValueError(
                f"window_s: {config.window_s:g}, but the shortest flight has {shortest / RATE_HZ:g} s"
            )
        self.validation = {path: load_training_flights([path]) for path in config.validation}
        self.first = (
            load_circuit(config.init).parameters
            if config.init
            else untrained(config.vectors, config.gates, config.seed, NOISE)
        )

    def contents(self) -> dict[str, str]:
        """Return the digests of the flights."""
        data = dict(zip(self.config.data, self.parts, strict=True))
        return {path: part.digest() for path, part in (data | self.validation).items()}

    def begin(self) -> None:
        """Draw the streams, and initialise weights, Adam's moments and averaged weights."""
        rng = np.random.default_rng([self.config.seed, 0])
        self.streams = draw_streams(self.parts, self.config, self.steps, rng)
        vehicles = sorted({vehicle for part in self.parts for vehicle in part.vehicles})
        self.note = {"vehicles": vehicles, "training_flights": sum(map(len, self.parts))}
        self.parts = []  # whose memory is not needed any more
        self.stream_weights = stream_weights(self.streams)
        self.weights = _flat(self.first)
        self.first_moment, self.second_moment = 0 * self.weights, 0 * self.weights
        self.slow = self.weights.copy()

    def one_epoch(self, number: int) -> Epoch:
        """Run `EPOCH_UPDATES` updates, or the remaining ones; validate after the last."""
        run, losses, longest, rate = self.config, [], 0.0, 0.0
        last = min((number + 1) * EPOCH_UPDATES, run.updates)
        factors = np.concatenate(
            [np.full(getattr(self.first, name).size, STEP.get(name, 1.0)) for name in LEARNT]
        )
        for k in range(number * EPOCH_UPDATES, last):
            rng = np.random.default_rng([run.seed, 1, k])
            streams = len(self.stream_weights)
            rows = rng.choice(streams, min(run.batch_size, streams), replace=False)
            p = _with(self.first, self.weights)
            loss, slope, trace = loss_and_gradient(p, self.streams.batch(rows), self.stream_weights[rows])
            gradient, size = _flat(slope), float(np.abs(trace.x).max())
            longest = max(longest, size)
            if not np.isfinite(loss) or not np.isfinite(gradient).all() or size > DIVERGED:
                self.weights, self.first_moment = self.slow.copy(), 0 * self.first_moment
                continue
            gradient *= min(1.0, 1.0 / np.linalg.norm(gradient))
            self.first_moment = BETA1 * self.first_moment + (1 - BETA1) * gradient
            self.second_moment = BETA2 * self.second_moment + (1 - BETA2) * gradient**2
            rate = run.learning_rate * 0.5 * (1 + np.cos(np.pi * k / run.updates)) * min(1, (k + 1) / WARM_UP)
            mean = self.first_moment / (1 - BETA1 ** (k + 1))
            deviation = np.sqrt(self.second_moment / (1 - BETA2 ** (k + 1))) + 1e-7
            self.weights = self.weights - factors * rate * mean / deviation
            self.slow = SLOW * self.slow + (1 - SLOW) * self.weights
            losses.append(loss)
        return Epoch(
            epoch=number,
            updates=last,
            train_loss=float(np.mean(losses)) if losses else float("nan"),
            learning_rate=float(rate),
            figures={"longest": longest},
            validation=self._validation() if last == run.updates else {},
        )

    def _validation(self) -> dict[str, float]:
        """Return the validation errors, also for the circuit that the run continued [deg]."""
        found = {}
        for path, flights in self.validation.items():
            name = Path(path).stem
            found[f"{name}_deg"] = validation_error(self.circuit(), flights)
            if self.config.init:
                found[f"{name}_before_training_deg"] = validation_error(self.first, flights)
        return found

    def circuit(self) -> Parameters:
        """Return the circuit of the averaged weights, adjusted for flight."""
        return as_flown(scale_vectors(_with(self.first, self.slow), self.streams))

    def save(self, file: Path, note: dict[str, Any]) -> None:
        """Write the circuit; `note` is stored in the file."""
        vectors, gates = self.config.vectors, self.config.gates
        about = CircuitConfig(vectors=vectors, gates=gates, training=note | self.note)
        save_circuit(file, about, self.circuit())

    def state_dict(self) -> dict[str, Any]:
        """Return everything that a resumed run needs."""
        return {name: torch.from_numpy(getattr(self, name)) for name in STATE}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from the result of `state_dict`."""
        for name in STATE:
            setattr(self, name, state[name].numpy())


STATE = ("weights", "first_moment", "second_moment", "slow")
"""Attributes that change in an update."""


def _flat(p: Parameters) -> Array:
    return np.concatenate([np.ravel(getattr(p, name)) for name in LEARNT])


def _with(p: Parameters, weights: Array) -> Parameters:
    """Return the circuit with other trained parameters."""
    values, at = {}, 0
    for name in LEARNT:
        shape = getattr(p, name).shape
        size = int(np.prod(shape))
        values[name] = weights[at : at + size].reshape(shape)
        at += size
    return p._replace(**values)


def stream_weights(streams: Streams) -> NDArray[np.float32]:
    """Return weights of the streams in the loss: 1 / (error of the untrained circuit + 0.5°).

    With these weights, calm and agile flights have a similar influence.
    """
    p, errors = untrained(), []
    for first in range(0, len(streams.known), 64):
        batch = streams.batch(np.arange(first, min(first + 64, len(streams.known))))
        cosines = cosine(run_streams(p, batch), batch.up)
        errors.append(np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean(0))
    weights = 1 / (np.concatenate(errors) + 0.5)
    return (weights / weights.mean()).astype(np.float32)


def scale_vectors(p: Parameters, streams: Streams) -> Parameters:
    """Return the circuit with scales of its vectors from their lengths on streams."""
    trace = run_streams(p, streams.batch(np.arange(min(128, len(streams.known)))))
    size = np.abs(trace.x[1:]).transpose(1, 0, 2, 3).reshape(len(p.start), -1)
    return p._replace(scale=np.quantile(size, RANGE_QUANTILE, axis=1).astype(np.float64) / RANGE)


def validation_error(p: Parameters, flights: TrainingFlights) -> float:
    """Return the mean absolute error with spikes over complete flights from an unknown start [deg]."""
    estimator = circuit_estimator("att-snn", p)
    estimator.reset(len(flights))
    return float(absolute_error(estimator.sequence(flights.gyro, flights.accel), flights.roll_pitch).mean())
