"""Sizes of the run: flights, updates, swarms; and the two presets."""

from __future__ import annotations

from typing import Annotated, Any

from quadsim.config.ranges import Between, SampleRate
from quadsim.config.toml import Strict

Number = Annotated[int, Between(1, 1_000_000)]
Seconds = Annotated[float, Between(0.01, 3600.0, "s")]


class Budget(Strict):
    """Length of a training."""

    epochs: Number
    batches: Number
    """Updates in an epoch."""
    window_s: Seconds = 5.0
    """Length of a window [s]."""
    windows_per_stream: Number = 3
    """Windows that follow one another with the state carried to the next."""
    batch_size: Number = 40
    """Windows in a batch."""

    @property
    def updates(self) -> int:
        """In all."""
        return self.epochs * self.batches

    def __str__(self) -> str:
        """As pages say it."""
        return f"{self.updates} updates of {self.batch_size} windows of {self.window_s:g} s"


class PaperSettings(Strict):
    """Sizes of all that `quadsim paper` does; the defaults are the paper's sizes, preset "full"."""

    preset: str
    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    sim_flights: Number = 35
    """Training flights of the Hummingbird, as many as the paper simulated."""
    real_flights: Number = 11
    """Training flights of the second airframe, as many as the paper flew."""
    validation_flights: tuple[Number, Number] = (4, 2)
    """Further flights of both, which choose epochs."""
    test_flights: tuple[Number, Number] = (12, 12)
    """Further flights of both, for scoring alone."""
    flight_s: Seconds = 100.0
    folds: Number = 5
    particles: Number = 100
    """Parameter sets that a filter's tuning tries at once."""
    iterations: Number = 20
    """How often."""
    main: Budget = Budget(epochs=150, batches=30)
    """Att-SNN of Table 2 and of everything after it, and its twin in floats."""
    paper: Budget = Budget(epochs=60, batches=15, window_s=10.0, windows_per_stream=1)
    """Att-SNN by the paper's recipe."""
    rnn: Budget = Budget(epochs=36, batches=24, window_s=2.5, windows_per_stream=6)
    """Att-RNN."""
    fold_snn: Budget = Budget(epochs=16, batches=45)
    fold_rnn: Budget = Budget(epochs=5, batches=24, window_s=2.5, windows_per_stream=6)
    study: Budget = Budget(epochs=16, batches=45)
    """Each network of the pages on size and on minutes of flight."""
    rates_hz: tuple[SampleRate, ...] = (100.0, 200.0, 500.0, 1000.0)
    rate_flights: tuple[Number, Number, Number] = (16, 3, 8)
    """Flights at each rate: training, validation, test."""
    rate: Budget = Budget(epochs=10, batches=24)
    """Training on, at each rate."""
    sizes: tuple[Number, ...] = (20, 40, 80, 120, 160, 200)
    """Neurons of both layers together; the last is the whole network."""
    minutes_flights: tuple[Number, ...] = (1, 2, 5, 10, 20, 35)
    """Training flights; the last is all of the Hummingbird's."""
    latency_rounds: Number = 40
    """Turns of a hundred calls."""
    loop_seeds: Number = 8
    loop_s: Seconds = 100.0
    """Length of the closed-loop flights [s]."""


PRESETS: dict[str, dict[str, Any]] = {
    "quick": {
        "sim_flights": 12,
        "real_flights": 6,
        "validation_flights": (2, 1),
        "test_flights": (4, 4),
        "flight_s": 50.0,
        "folds": 3,
        "particles": 16,
        "iterations": 12,
        "main": Budget(epochs=24, batches=24, window_s=2.5, windows_per_stream=6),
        "paper": Budget(epochs=16, batches=15, window_s=2.5, windows_per_stream=1),
        "rnn": Budget(epochs=12, batches=12, window_s=1.25, windows_per_stream=12),
        "fold_snn": Budget(epochs=5, batches=36, window_s=2.5, windows_per_stream=6),
        "fold_rnn": Budget(epochs=4, batches=12, window_s=1.25, windows_per_stream=12),
        "study": Budget(epochs=5, batches=36, window_s=2.5, windows_per_stream=6),
        "rates_hz": (100.0, 200.0, 500.0),
        "rate_flights": (6, 2, 4),
        "rate": Budget(epochs=3, batches=18, window_s=2.5, windows_per_stream=6),
        "sizes": (20, 80, 200),
        "minutes_flights": (1, 4, 12),
        "latency_rounds": 5,
        "loop_seeds": 3,
        "loop_s": 30.0,
    },
    "full": {},
}
"""What differs from the defaults. "quick" takes minutes: short flights and trainings, to try everything."""


def settings_of(preset: str, seed: int = 0) -> PaperSettings:
    """Sizes of a preset.

    Raises:
        ValueError: There is no such preset.
    """
    if preset not in PRESETS:
        raise ValueError(f"no preset {preset!r}, there are {' and '.join(PRESETS)}")
    return PaperSettings(preset=preset, seed=seed, **PRESETS[preset])
