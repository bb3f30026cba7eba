"""Sizes of the run: flights, epochs, swarms."""

import tomllib
from pathlib import Path
from typing import Annotated

from pydantic import ValidationError

from quadsim.config.ranges import Between, SampleRate
from quadsim.config.toml import Strict, describe
from quadsim.held_out import unreserved

Number = Annotated[int, Between(1, 1_000_000)]
Seconds = Annotated[float, Between(0.01, 3600.0, "s")]


class Budget(Strict):
    """Most that a training takes: the paper's rule ends it before, where its loss stops falling."""

    epochs: Number
    window_s: Seconds
    """Length of a window [s]."""
    batch_size: Number
    """Windows in a batch."""
    batches: Number = 15
    """Updates in an epoch."""


class PaperSettings(Strict):
    """Sizes of all that `quadsim paper` does."""

    preset: str
    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    sim_flights: Number
    """Flights of the Hummingbird that 70 % train and 20 % validate."""
    real_flights: Number
    """The same of the second airframe."""
    flight_s: Seconds
    test_flights: Number
    """Further flights of each, for scoring alone."""
    test_s: Seconds
    folds: Number
    """Draws of the 70/20/10 split."""
    particles: Number
    """Parameter sets that a filter's tuning tries at once."""
    iterations: Number
    """How often."""
    snn: Budget
    """Att-SNN, in floats and with Loihi's quantisation."""
    rnn: Budget
    """Att-RNN."""
    fold: Budget
    """Networks of further folds, of one domain alone, and with fixed time constants."""
    rate: Budget
    """Networks at other sample rates."""
    study: Budget
    """Networks trained on several minutes of flight."""
    ours_epochs: Number
    """Of the preset `hummingbird`, a thousand updates each."""
    rates_hz: tuple[SampleRate, ...]
    rate_flights: Number
    """Flights of `flight_s` at each rate."""
    minutes: tuple[Number, ...]
    """Flights of a minute that train."""
    minutes_validation: Number
    latency_rounds: Number
    """Turns of a hundred calls."""
    loop_seeds: Number
    loop_s: Seconds
    """Length of the closed-loop flights [s]."""

    @property
    def judges(self) -> bool:
        """Whether the run is large enough for verdicts."""
        return self.preset == "full"


PRESETS = tomllib.loads(Path(__file__).with_name("sizes.toml").read_text("utf-8"))


def settings_of(preset: str, seed: int = 0) -> PaperSettings:
    """Sizes of a preset.

    Raises:
        ValueError: There is no such preset, or the seed is out of range or of a held-out suite.
    """
    if preset not in PRESETS:
        raise ValueError(f"no preset {preset!r}, there are {' and '.join(PRESETS)}")
    try:
        found = PaperSettings.model_validate(PRESETS[preset] | {"preset": preset, "seed": seed})
    except ValidationError as error:
        raise ValueError(f"paper: {describe(error, PaperSettings)}") from error
    unreserved(found.seed)
    return found
