"""The training of attitude controllers: flights by a teacher, then labelled flights by the student."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from estimators.control.controller import SpikingController
from estimators.networks.weights_file import NetworkConfig, Tensors
from quadsim.flight.recipe import load_recipe
from quadsim.runs.files import replace
from quadsim.seeding import child

from ..config import TrainConfig
from ..data import Batch, network_inputs, windows_of
from ..init import initialise_controller
from ..models import AttSNN
from .labelled_flights import RATE_HZ, fly_labelled

if TYPE_CHECKING:
    from ..epochs import Student

FLIGHTS, VALIDATION, INITIAL, WINDOWS = range(4)
"""Children of a run's seed."""
INITIAL_WINDOWS, INITIAL_S = 24, 6.0
"""Number and length [s] of the windows for the initial network."""


class ControlTask:
    """Imitation of a teacher's angular accelerations, with the methods of `training.data.AttitudeTask`.

    Args:
        config: Configuration of the run.
        out: Folder of the run, which stores the flights of each round.
    """

    rate_hz = RATE_HZ

    def __init__(self, config: TrainConfig, out: Path) -> None:
        self.config, self.out = config, out
        self.recipe, self.scale = load_recipe(config.control.recipe), config.control.error_scale
        self.rounds: list[NDArray[np.void]] = []

    def contents(self) -> dict[str, str]:
        """Return the recipe of the flights."""
        return {"flights": self.recipe.model_dump_json()}

    def initial_model(self) -> AttSNN:
        """Return the initial network, solved from the teacher's flights."""
        config = self.config
        self.rounds = [self._round(0)]
        self.teacher_deg = tracking_deg(self._fly((VALIDATION,), config.control.validation_flights))
        drawn = config.model_copy(update={"batch_size": INITIAL_WINDOWS, "windows_per_stream": 1})
        steps = round(min(INITIAL_S, config.control.flight_s) * self.rate_hz)
        batch = next(control_windows(self.rounds[0], drawn, steps, (config.seed, INITIAL)))
        model = AttSNN(config)
        initialise_controller(model, network_inputs(config, batch).numpy(), batch.target, config.seed)
        return model

    def _fly(self, key: Sequence[int], n: int, *pilots: Any) -> NDArray[np.void]:
        """Simulate flights of a child of the run's seed; `pilots` are a student and the teacher's share."""
        seeds = [child(np.random.SeedSequence([self.config.seed, *key]), i) for i in range(n)]
        return fly_labelled(self.recipe, seeds, self.config.control.flight_s, *pilots)

    def _round(self, number: int, student: Student | None = None) -> NDArray[np.void]:
        """Return the flights of a round, from its file if there is one."""
        control, file = self.config.control, self.out / f"round-{number}.npy"
        if not file.is_file():
            n = control.round_flights if student else control.flights
            pilot = SpikingController(*student()) if student else None
            flights = self._fly((FLIGHTS, number), n, pilot, control.teacher_share**number)
            replace(file, lambda part: np.save(part, flights))
        try:
            return np.load(file, allow_pickle=False)
        except (ValueError, EOFError, OSError) as error:
            raise ValueError(f"{file}: damaged, choose another folder for the run") from error

    def windows(self, epoch: int, student: Student) -> Iterator[Batch]:
        """Return the windows of an epoch, after simulating the flights of its round."""
        config = self.config
        while len(self.rounds) <= config.round_of(epoch):
            self.rounds.append(self._round(len(self.rounds), student))
        seed, steps = (config.seed, WINDOWS, epoch), config.steps(self.rate_hz)
        return control_windows(np.concatenate(self.rounds), config, steps, seed)

    def validate(self, network: NetworkConfig, tensors: Tensors) -> dict[str, float]:
        """Return measures of the student's flights.

        `tracking_deg` is the RMS angle between commanded and true thrust axis, where a crash counts as 90°.
        `teacher_deg` is the same for the teacher. `imitation` is the RMS error of the outputs divided by the
        error scale. `crashes` is the number of crashes.
        """
        student = SpikingController(network, tensors)
        flown = self._fly((VALIDATION,), self.config.control.validation_flights, student)
        valid = flown["valid"] > 0
        student.reset(len(flown))
        out = student.sequence(flown["set_point"], flown["gyro"], flown["accel"])[..., :3]
        error = (out - flown["target"])[valid] / np.array(self.scale)
        return {
            "tracking_deg": tracking_deg(flown),
            "teacher_deg": self.teacher_deg,
            "crashes": float((~valid[:, -1]).sum()),
            "imitation": float(np.sqrt(np.mean(error**2))) if valid.any() else np.inf,
        }

    def note(self) -> dict[str, Any]:
        """Return the description of the flights for the weights file."""
        return {"vehicles": [self.recipe.vehicle.name], "training_flights": sum(map(len, self.rounds))}


def tracking_deg(flights: NDArray[np.void]) -> float:
    """Return the RMS tracking error over flights, where a crash counts as 90° [deg]."""
    squares = np.degrees(flights["error"]) ** 2
    return float(np.sqrt(np.mean(np.where(flights["valid"][:, -1:], squares, 90.0**2))))


def control_windows(
    flights: NDArray[np.void], config: TrainConfig, steps: int, seed: Sequence[int]
) -> Iterator[Batch]:
    """Return the windows of an epoch; see `training.data.windows_of`.

    Half of the streams begin at the start of a flight.
    """
    end = flights["valid"].sum(axis=1)
    if end.max() < steps:
        raise ValueError("every flight ends within a window: give a smaller window_s")

    def draw(n: int, length: int, rng: np.random.Generator) -> tuple[NDArray, ...]:
        rows = rng.choice(np.flatnonzero(end >= length), n)
        first = rng.integers(end[rows] - length + 1) * rng.integers(2, size=n)
        part = flights[rows[:, None], first[:, None] + np.arange(length)]
        return part["gyro"], part["accel"], part["target"], part["set_point"]

    return windows_of(draw, int(end.max()), config, steps, seed)
