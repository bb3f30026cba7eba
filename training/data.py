"""The training of attitude estimators: flights in memory, their split, and successive windows."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from estimators.control.controller import follow
from estimators.evaluation.flights import vehicle_of
from estimators.metrics import absolute_error, inclination_error
from estimators.networks.encoder import INPUT_ONE, scaled_inputs
from estimators.networks.gru import Recurrent
from estimators.networks.network import NetworkEstimator, Spiking
from estimators.networks.weights_file import NetworkConfig, Tensors
from quadsim.dataset.reading import open_dataset
from quadsim.held_out import unreserved
from quadsim.rotation import quat_rotate_inverse, roll_pitch_of_up

from .augment import measured
from .config import TrainConfig
from .init import initialise_random
from .models import AttRNN, AttSNN

Float32 = NDArray[np.float32]
SIGNALS = ("ang_vel", "specific_force", "gyro", "accel", "up")


@dataclass(frozen=True)
class TrainingFlights:
    """Flights of equal length, float32, shape (n, T, 3), body axes."""

    ang_vel: Float32
    """True body rate [rad/s]; `gyro` is the measured one."""
    specific_force: Float32
    """True specific force [m/s²]; `accel` is the measured one."""
    gyro: Float32
    accel: Float32
    up: Float32
    """World's z axis in body axes."""
    rate_hz: float
    """Samples per second."""
    vehicles: tuple[str, ...] = ()
    """Names of the airframes, if known."""

    def __len__(self) -> int:
        """Number of flights."""
        return len(self.gyro)

    @property
    def roll_pitch(self) -> NDArray[np.float64]:
        """True roll and pitch, shape (n, T, 2) [rad]."""
        return roll_pitch_of_up(self.up)

    def digest(self) -> str:
        """Return the digest of all samples."""
        digest = hashlib.blake2b(f"{self.rate_hz}".encode(), digest_size=16)
        for name in SIGNALS:
            digest.update(np.ascontiguousarray(getattr(self, name)).data)
        return digest.hexdigest()

    def select(self, ids: Sequence[int] | NDArray[np.int64]) -> TrainingFlights:
        """Return some of the flights."""
        index = np.asarray(ids, dtype=np.int64)
        signals = (getattr(self, name)[index] for name in SIGNALS)
        return TrainingFlights(*signals, rate_hz=self.rate_hz, vehicles=self.vehicles)


def load_training_flights(paths: Sequence[str | Path]) -> TrainingFlights:
    """Read the complete flights of one or more datasets; flights that ended early are left out.

    Raises:
        FileNotFoundError: A dataset does not exist.
        ValueError: A path is not a dataset, datasets differ in rate or length, or no flight is complete.
    """
    parts = [_read(Path(path)) for path in paths]
    rates = {part.rate_hz for part in parts}
    if len(rates) > 1:
        raise ValueError(f"datasets of different rates: {sorted(rates)} Hz")
    steps = min(part.gyro.shape[1] for part in parts)
    joined = (np.concatenate([getattr(part, name)[:, :steps] for part in parts]) for name in SIGNALS)
    vehicles = sorted({vehicle for part in parts for vehicle in part.vehicles})
    return TrainingFlights(*joined, rate_hz=rates.pop(), vehicles=tuple(vehicles))


def _read(path: Path) -> TrainingFlights:
    data = open_dataset(path)
    unreserved(int(data.attrs["seed"]))
    complete = np.flatnonzero(data["valid_steps"].to_numpy() == data.sizes["time"])
    if complete.size == 0:
        raise ValueError(f"{path}: no flight that lasts to the end")
    data = data.isel(flight=complete)
    quat = data["quat"].to_numpy().astype(np.float64)
    up = quat_rotate_inverse(quat, np.broadcast_to([0.0, 0.0, 1.0], (*quat.shape[:-1], 3)))
    measured = (data[name].to_numpy().astype(np.float32) for name in SIGNALS[:-1])
    by_hand = json.loads(data.attrs.get("config", "{}")).get("hand_held") is not None
    vehicle = None if by_hand else vehicle_of(data)
    vehicles = () if vehicle is None else (vehicle.name,)
    rate_hz = float(data.attrs["rate_hz"])
    return TrainingFlights(*measured, up=up.astype(np.float32), rate_hz=rate_hz, vehicles=vehicles)


def split_flights(config: TrainConfig) -> tuple[TrainingFlights, TrainingFlights, TrainingFlights]:
    """Return the flights for training, validation and testing; with `validation`, no test flights.

    Raises:
        ValueError: There are too few flights, flights are too short, or the datasets are not compatible.
    """
    flights = load_training_flights(config.data)
    steps, available = config.steps(flights.rate_hz), flights.gyro.shape[1]
    if steps < 1:
        raise ValueError("windows of no sample: give a larger window_s")
    if steps > available:
        raise ValueError(
            f"windows of {steps} samples, but the flights have {available}: give a smaller window_s"
        )
    if not config.validation:
        train, choose, test = map(flights.select, split_ids(len(flights), config.seed))
        return train, choose, test
    validation, rate = load_training_flights(config.validation), flights.rate_hz
    if validation.rate_hz != rate:
        raise ValueError(f"validation at {validation.rate_hz:g} Hz, but the data are at {rate:g} Hz")
    return flights, validation, flights.select([])


def split_ids(flights: int, seed: int) -> list[NDArray]:
    """Draw 70 % training, 20 % validation and 10 % test flights without replacement, at least one each.

    Raises:
        ValueError: There are fewer than three flights.
    """
    if flights < 3:
        raise ValueError(f"a split needs at least 3 flights, got {flights}")
    order = np.random.default_rng(np.random.SeedSequence(seed)).permutation(flights)
    last, middle = max(1, round(0.1 * flights)), max(1, round(0.2 * flights))
    return [np.sort(order[: -last - middle]), np.sort(order[-last - middle : -last]), np.sort(order[-last:])]


COHORTS = 8
"""Number of parts of a batch whose streams begin and end together."""


class Batch(NamedTuple):
    """One window of every stream, float32."""

    gyro: Float32
    """Measured body rate (n, T, 3) [rad/s]."""
    accel: Float32
    """Measured specific force (n, T, 3) [m/s²]."""
    target: Float32
    """Target of the outputs after each sample, (n, T, outputs)."""
    reset: NDArray[np.bool_]
    """Streams (n,) that begin with this window, from a state of zero; the others continue from the last
    window."""
    set_point: Float32 | None = None
    """Set-points of a controller (n, T, 4)."""


Draw = Callable[[int, int, np.random.Generator], tuple[NDArray, ...]]
"""Called as draw(n, length, rng): returns parts of n flights, the fields of `Batch` except `reset`, (n,
length, ·)."""


def attitude_windows(
    flights: TrainingFlights, config: TrainConfig, steps: int, seed: Sequence[int]
) -> Iterator[Batch]:
    """Return the windows of an epoch; see `windows_of`.

    The IMU is drawn once per stream, noise per sample.
    """

    def draw(n: int, length: int, rng: np.random.Generator) -> tuple[NDArray, ...]:
        rows = rng.integers(len(flights), size=n)[:, None]
        first = rng.integers(flights.gyro.shape[1] - length + 1, size=n)
        index = rows, first[:, None] + np.arange(length)
        rate, force, up = flights.ang_vel[index], flights.specific_force[index], flights.up[index]
        gyro, accel = measured(config.imu, rate, force, flights.rate_hz, rng)
        return gyro, accel, roll_pitch_of_up(up).astype(np.float32)

    return windows_of(draw, flights.gyro.shape[1], config, steps, seed)


def windows_of(
    draw: Draw, longest: int, config: TrainConfig, steps: int, seed: Sequence[int]
) -> Iterator[Batch]:
    """Yield the windows of an epoch: streams start anywhere in a flight and are cut into windows.

    The length of a stream is log-uniform, from one window to `windows_per_stream`, so that every batch has
    streams that have just begun and streams that have settled.

    Args:
        draw: Function that draws streams.
        longest: Number of samples of the longest flight, which limits `windows_per_stream`.
        config: Configuration of the run.
        steps: Number of samples in a window.
        seed: Seed of the epoch.
    """
    most = min(config.windows_per_stream, longest // steps)
    sizes = [len(part) for part in np.array_split(np.arange(config.batch_size), COHORTS) if len(part)]
    seeds = np.random.SeedSequence(list(seed)).spawn(len(sizes))
    cohorts = [
        _streams(draw, n, steps, most, np.random.default_rng(each))
        for n, each in zip(sizes, seeds, strict=True)
    ]
    for _ in range(config.batches):
        parts = [next(cohort) for cohort in cohorts]
        yield Batch(*(np.concatenate(signal) for signal in zip(*parts, strict=True)))


def _streams(
    draw: Draw, n: int, steps: int, most: int, rng: np.random.Generator
) -> Iterator[tuple[NDArray, ...]]:
    """Yield windows of `n` streams of equal length, then of `n` others, with the fields of `Batch`."""
    while True:
        length = int(np.exp(rng.uniform(0, np.log(most + 1)))) * steps
        signals = draw(n, length, rng)
        for k in range(0, length, steps):
            gyro, accel, target, *others = (each[:, k : k + steps] for each in signals)
            yield gyro, accel, target, np.full(n, k == 0), *others


def network_inputs(config: TrainConfig, batch: Batch, state: NDArray[np.void] | None = None) -> Tensor:
    """Return scaled inputs, shape (n, T, inputs); `state` is as in `scaled_inputs`."""
    x = scaled_inputs(config.inputs, batch.gyro, batch.accel, state)
    if config.model == "att-rnn":
        return torch.from_numpy(x.astype(np.float32))
    if batch.set_point is not None:
        wanted = follow(config.control.set_point, batch.set_point.astype(np.float64)).inputs / INPUT_ONE
        x = np.concatenate([x, wanted], 2)
    return torch.from_numpy(x)


SETTLED_S = 5.0
"""Time after the start that `settled_deg` leaves out [s]."""


class AttitudeTask:
    """The training of a network of layers as an attitude estimator: flights, inputs, targets and validation.

    `training.control.task` has the corresponding class for controllers.
    """

    scale = (1.0,)
    """Errors of the outputs with equal weight in the loss."""

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        self.flights, self.validation, _ = split_flights(config)
        self.rate_hz = self.flights.rate_hz

    def contents(self) -> dict[str, str]:
        """Return the digests of the flights, so that a run cannot continue with others."""
        return {"data": self.flights.digest(), "validation": self.validation.digest()}

    def initial_model(self) -> AttSNN | AttRNN:
        """Return the initial network."""
        if self.config.model == "att-rnn":
            return AttRNN(self.config)
        model = AttSNN(self.config)
        initialise_random(model, self.config.seed)
        return model

    def windows(self, epoch: int, student: Any) -> Iterator[Batch]:
        """Return the windows of an epoch, counted from 0; the student is not used."""
        steps = self.config.steps(self.rate_hz)
        return attitude_windows(self.flights, self.config, steps, (self.config.seed, 1, epoch))

    def validate(self, network: NetworkConfig, tensors: Tensors) -> dict[str, float]:
        """Return errors over complete validation flights from an unknown start.

        `loss` is the mean square error [rad²] and selects the best epoch. `error_deg` is the mean absolute
        error of roll and pitch, `settled_deg` the same without the first 5 s, and `inclination_deg` the RMS
        inclination error.
        """
        core = Spiking(network, tensors) if network.model == "att-snn" else Recurrent(network, tensors)
        estimator = NetworkEstimator(core, network.rate_hz)
        flights, truth = self.validation, self.validation.roll_pitch
        estimator.reset(len(flights))
        estimate = estimator.sequence(flights.gyro, flights.accel)
        error = absolute_error(estimate, truth)
        settled = error[:, round(SETTLED_S * flights.rate_hz) :]
        inclination = float(np.sqrt(np.mean(inclination_error(estimate, truth) ** 2)))
        return {
            "loss": float(np.mean((estimate - truth) ** 2)),
            "error_deg": float(error.mean()),
            "settled_deg": float((settled if settled.size else error).mean()),
            "inclination_deg": inclination,
        }

    def note(self) -> dict[str, Any]:
        """What the weights say of the flights."""
        sizes = {"training_flights": len(self.flights), "validation_flights": len(self.validation)}
        return {"vehicles": list(self.flights.vehicles)} | sizes
