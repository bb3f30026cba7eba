"""The held-out suite of a release: ranges of its scenarios, and seeds that are reserved for them."""

from typing import Annotated

from .config.ranges import Between, Duration, Rising, Speed
from .config.toml import Strict, load_toml, preset_names

SEEDS = 1_000_000
"""Number of seeds that a suite reserves, starting with its own."""
Tilt = Annotated[float, Between(0.0, 55.0, "°")]


class HeldOut(Strict):
    """A held-out suite: the ranges from which its scenarios are drawn."""

    release: str
    """Release that uses this suite."""
    seed: Annotated[int, Between(0, 2**31)]
    """Seed of all random numbers. Training, tuning and other suites refuse this seed and the `SEEDS` - 1
    after it."""
    scenarios: Annotated[int, Between(1, 10_000)]
    """Number of scenarios."""
    flights: Annotated[int, Between(1, 10_000)]
    """Number of flights of each estimator in each scenario."""
    wind: Annotated[tuple[Speed, Speed], Rising]
    """Range of the mean wind speed, from any direction [m/s]."""
    wind_20ft: Annotated[tuple[Speed, Speed], Rising]
    """Range of the strength of Dryden turbulence, which half of the scenarios have [m/s]."""
    period_s: Annotated[tuple[Duration, Duration], Rising]
    """Range of the time for a lap of the figure of eight [s]."""
    tilt_deg: Annotated[tuple[Tilt, Tilt], Rising]
    """Range of the largest commanded tilt of random manoeuvres [deg]."""


def load_held_out(release: str) -> HeldOut:
    """Load the suite of a release, by the name of the release ("0.2").

    Raises:
        ValueError: The release has no suite.
    """
    return load_toml(release, "held-out", HeldOut)


def releases() -> list[str]:
    """Return the releases that have a suite, the oldest first."""
    return preset_names("held-out")


def reserved_by(seed: int) -> HeldOut | None:
    """Return the held-out suite that reserves a seed, if any."""
    suites = map(load_held_out, releases())
    return next((suite for suite in suites if suite.seed <= seed < suite.seed + SEEDS), None)


def unreserved(seed: int) -> int:
    """Return a seed if no held-out suite reserves it.

    Raises:
        ValueError: A held-out suite reserves the seed.
    """
    if suite := reserved_by(seed):
        raise ValueError(
            f"seed {seed} is of the held-out suite of {suite.release}, on which nothing is trained, tuned or "
            f"chosen; give one below {suite.seed} or from {suite.seed + SEEDS} on"
        )
    return seed
