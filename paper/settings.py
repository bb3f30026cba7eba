"""Sizes of the run: flights, epochs, swarms; and the two presets."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import ValidationError, model_validator

from quadsim.config.ranges import Between, SampleRate
from quadsim.config.toml import Strict, describe
from quadsim.held_out import unreserved

Number = Annotated[int, Between(1, 1_000_000)]
Seconds = Annotated[float, Between(0.01, 3600.0, "s")]


class Budget(Strict):
    """Most that a training takes: the paper's rule ends it before, where its loss stops falling."""

    epochs: Number = 500
    batches: Number = 15
    """Updates in an epoch."""
    window_s: Seconds = 10.0
    """Length of a window [s]."""
    batch_size: Number = 40
    """Windows in a batch."""

    def __str__(self) -> str:
        """As pages say it."""
        updates = f"{self.batches} updates of {self.batch_size} windows of {self.window_s:g} s"
        return f"{self.epochs} epochs of {updates}"


class PaperSettings(Strict):
    """Sizes of all that `quadsim paper` does; the defaults are the paper's sizes, preset "full"."""

    preset: str
    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    sim_flights: Number = 35
    """Flights of the Hummingbird that 70 % train and 20 % validate, as many as the paper simulated."""
    real_flights: Number = 11
    """The same of the second airframe, as many as the paper flew."""
    flight_s: Seconds = 100.0
    test_flights: Number = 40
    """Further flights of each, for scoring alone, as many as the paper's."""
    test_s: Seconds = 50.0
    folds: Number = 5
    """Draws of the 70/20/10 split."""
    particles: Number = 100
    """Parameter sets that a filter's tuning tries at once."""
    iterations: Number = 20
    """How often."""
    snn: Budget = Budget()
    """Att-SNN, in floats and with Loihi's quantisation."""
    rnn: Budget = Budget(epochs=250)
    """Att-RNN."""
    fold: Budget = Budget(epochs=170)
    """Networks of further folds, of one domain alone, and with fixed time constants."""
    ours_epochs: Number = 30
    """Of the preset `hummingbird`, a thousand updates each."""
    rates_hz: tuple[SampleRate, ...] = (100.0, 200.0, 500.0, 1000.0)
    rate_flights: Number = 20
    """Flights of `flight_s` at each rate."""
    rate: Budget = Budget(epochs=100)
    minutes: tuple[Number, ...] = (1, 3, 10, 30, 60)
    """Flights of a minute that train."""
    minutes_validation: Number = 9
    study: Budget = Budget(epochs=170)
    """Networks trained on several minutes of flight."""
    latency_rounds: Number = 40
    """Turns of a hundred calls."""
    loop_seeds: Number = 8
    loop_s: Seconds = 100.0
    """Length of the closed-loop flights [s]."""

    @model_validator(mode="after")
    def _fits(self) -> PaperSettings:
        unreserved(self.seed)
        return self

    @property
    def judges(self) -> bool:
        """Whether the run is large enough for verdicts."""
        return self.preset == "full"


SHORT = Budget(epochs=25, window_s=5.0, batch_size=20)
PRESETS: dict[str, dict[str, Any]] = {
    "quick": {
        "sim_flights": 14,
        "real_flights": 6,
        "flight_s": 50.0,
        "test_flights": 8,
        "test_s": 25.0,
        "folds": 2,
        "particles": 20,
        "iterations": 15,
        "snn": Budget(epochs=60, window_s=5.0),
        "rnn": Budget(epochs=30, window_s=2.5),
        "fold": SHORT,
        "ours_epochs": 3,
        "rates_hz": (100.0, 200.0, 500.0),
        "rate_flights": 6,
        "rate": SHORT,
        "minutes": (1, 3, 10),
        "minutes_validation": 3,
        "study": SHORT,
        "latency_rounds": 5,
        "loop_seeds": 3,
        "loop_s": 30.0,
    },
    "full": {},
}
"""What differs from the defaults. "quick" takes minutes: short flights and trainings, for a look."""


def settings_of(preset: str, seed: int = 0) -> PaperSettings:
    """Sizes of a preset.

    Raises:
        ValueError: There is no such preset, or the seed is out of range or of a held-out suite.
    """
    if preset not in PRESETS:
        raise ValueError(f"no preset {preset!r}, there are {' and '.join(PRESETS)}")
    try:
        return PaperSettings(preset=preset, seed=seed, **PRESETS[preset])
    except ValidationError as error:
        raise ValueError(f"paper: {describe(error, PaperSettings)}") from error
