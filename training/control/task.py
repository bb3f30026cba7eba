"""The task of attitude controllers: flights by a teacher, then by the student, which the teacher labels."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.control.controller import SpikingController
from estimators.networks.weights_file import NetworkConfig, Tensors
from quadsim.flight.recipe import load_recipe
from quadsim.runs.files import write_whole
from quadsim.seeding import child

from ..config import TrainConfig
from ..data import Batch, network_inputs
from ..init import initialise_controller
from ..models import AttSNN
from .labelled_flights import RATE_HZ, SIGNALS, ControlFlights, fly, joined

if TYPE_CHECKING:
    from ..epochs import Student

FLIGHTS, VALIDATION, INITIAL, WINDOWS = range(4)
"""Children of a run's seed."""
CRASH_DEG = 90.0
"""What a crashed validation flight counts as [deg]."""
INITIAL_WINDOWS = 24
"""Windows that the initial network is solved on, and"""
INITIAL_S = 6.0
"""their length [s]."""


class ControlTask:
    """Angular accelerations of a teacher, from set-points and readings; see `training.epochs.Task`.

    Args:
        config: Of the run.
        out: Its folder, where the flights of each round are kept.
    """

    rate_hz = RATE_HZ

    def __init__(self, config: TrainConfig, out: Path) -> None:
        self.config, self.out = config, out
        self.recipe = load_recipe(config.control.recipe)
        self.scale = config.control.error_scale
        self.rounds: list[ControlFlights] = []
        self.teacher_deg = math.nan

    def contents(self) -> dict[str, str]:
        """The recipe of the flights."""
        return {"flights": self.recipe.model_dump_json()}

    def initial_model(self) -> AttSNN:
        """The network before the first update, after the teacher's flights."""
        config = self.config
        self.rounds = [self._round(0)]
        self.teacher_deg = tracking_deg(self._validation_flights(None))
        long = config.model_copy(update={"window_s": min(INITIAL_S, config.control.flight_s)})
        seed = np.random.SeedSequence([config.seed, INITIAL])
        batch = next(
            windows(self.rounds[0], long, round(long.window_s * self.rate_hz), seed, INITIAL_WINDOWS)
        )
        model = AttSNN(config)
        initialise_controller(model, network_inputs(config, batch).numpy(), batch.target, config.seed)
        return model

    def _seeds(self, *key: int, n: int) -> list[np.random.SeedSequence]:
        return [child(np.random.SeedSequence([self.config.seed, *key]), i) for i in range(n)]

    def _round(self, number: int, student: Student | None = None) -> ControlFlights:
        """Flights of a round, from its file where there is one: the student's, after the teacher's."""
        control, file = self.config.control, self.out / f"round-{number}.npz"
        if not file.is_file():
            seeds = self._seeds(FLIGHTS, number, n=control.round_flights if student else control.flights)
            pilot = SpikingController(*student()) if student else None
            save_flights(file, fly(control, self.recipe, seeds, pilot, control.teacher_share**number))
        return read_flights(file)

    def _validation_flights(self, student: SpikingController | None) -> ControlFlights:
        seeds = self._seeds(VALIDATION, n=self.config.control.validation_flights)
        return fly(self.config.control, self.recipe, seeds, student)

    def windows(self, epoch: int, student: Student) -> Iterator[Batch]:
        """The windows of an epoch, after the flights of its round."""
        config = self.config
        while len(self.rounds) <= config.round_of(epoch):
            self.rounds.append(self._round(len(self.rounds), student))
        seed = np.random.SeedSequence([config.seed, WINDOWS, epoch])
        steps = config.steps(self.rate_hz)
        return windows(joined(self.rounds), config, steps, seed, config.batch_size)

    def validate(self, network: NetworkConfig, tensors: Tensors) -> dict[str, float]:
        """Figures of the student's flights.

        `tracking_deg`: RMS angle between commanded and true thrust axis, a crashed flight counted as 90°;
        `teacher_deg`: the same of the teacher; `crashes`; `imitation`: RMS error of the outputs over the
        error scale.
        """
        student = SpikingController(network, tensors)
        flown = self._validation_flights(student)
        student.reset(len(flown))
        out = student.sequence(flown.set_point, flown.gyro, flown.accel)[..., :3]
        valid = np.arange(out.shape[1]) < flown.end[:, None]
        error = (out - flown.target)[valid] / np.array(self.scale)
        return {
            "tracking_deg": tracking_deg(flown),
            "teacher_deg": self.teacher_deg,
            "crashes": float(flown.crashes),
            "imitation": float(np.sqrt(np.mean(error**2))) if valid.any() else math.inf,
        }

    def note(self) -> dict[str, Any]:
        """What the weights say of the flights."""
        return {"vehicles": [self.recipe.vehicle.name], "training_flights": sum(map(len, self.rounds))}


def tracking_deg(flights: ControlFlights) -> float:
    """Root mean square over flights of the tracking error, crashed ones counted as `CRASH_DEG` [deg]."""
    crashed = flights.end < flights.gyro.shape[1]
    return float(np.sqrt(np.mean(np.where(crashed, CRASH_DEG, flights.error_deg) ** 2)))


def windows(
    flights: ControlFlights, config: TrainConfig, steps: int, seed: np.random.SeedSequence, n: int
) -> Iterator[Batch]:
    """Windows of n streams for an epoch: each starts anywhere in a flight and is cut into successive windows.

    Streams differ in length, log-uniform up to `windows_per_stream`; half of them start with their flight.
    """
    rng, available = np.random.default_rng(seed), flights.end
    if not np.any(available >= steps):
        raise ValueError("every flight ends within a window: give a smaller window_s")
    place, left, row = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)
    for _ in range(config.batches):
        reset = left == 0
        for i in np.flatnonzero(reset):
            most = min(config.windows_per_stream, int(available.max()) // steps)
            left[i] = int(math.exp(rng.uniform(0.0, math.log(most + 1))))
            while not np.any(available >= left[i] * steps):
                left[i] -= 1
            row[i] = rng.choice(np.flatnonzero(available >= left[i] * steps))
            latest = int(available[row[i]]) - left[i] * steps
            place[i] = 0 if rng.random() < 0.5 else rng.integers(latest + 1)
        index = row[:, None], place[:, None] + np.arange(steps)
        gyro, accel, set_point, target = (getattr(flights, name)[index] for name in SIGNALS)
        yield Batch(gyro, accel, target, reset, set_point)
        place += steps
        left -= 1


def save_flights(file: Path, flights: ControlFlights) -> None:
    """Write flights as an archive of arrays."""
    np.savez(buffer := io.BytesIO(), **asdict(flights))
    write_whole(file, buffer.getvalue())


def read_flights(file: Path) -> ControlFlights:
    """Read what `save_flights` wrote.

    Raises:
        ValueError: The file is damaged.
    """
    try:
        with np.load(file, allow_pickle=False) as stored:
            return ControlFlights(**stored)
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{file}: damaged, choose another folder for the run") from error
