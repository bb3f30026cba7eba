"""The held-out suite of a release: ranges that flights are drawn from, and seeds that nothing else uses."""

from typing import Annotated

from .config.ranges import Between, Duration, Rising, Speed
from .config.toml import Strict, load_toml, preset_names

SEEDS = 1_000_000
"""Seeds that a suite reserves, from its own on."""
Tilt = Annotated[float, Between(0.0, 55.0, "°")]


class HeldOut(Strict):
    """A held-out suite: the ranges from which its scenarios are drawn."""

    release: str
    """Release that uses this suite."""
    seed: Annotated[int, Between(0, 2**31)]
    """Of everything that is drawn; it and the `SEEDS` - 1 after it are refused elsewhere."""
    scenarios: Annotated[int, Between(1, 10_000)]
    """Number of scenarios."""
    flights: Annotated[int, Between(1, 10_000)]
    """Number of flights of each estimator in each scenario."""
    wind: Annotated[tuple[Speed, Speed], Rising]
    """Mean wind, from any side [m/s]."""
    wind_20ft: Annotated[tuple[Speed, Speed], Rising]
    """Strength of Dryden turbulence, in half of the scenarios [m/s]."""
    period_s: Annotated[tuple[Duration, Duration], Rising]
    """Time of a lap of the figure of eight [s]."""
    tilt_deg: Annotated[tuple[Tilt, Tilt], Rising]
    """Largest commanded tilt of random manoeuvres [deg]."""


def load_held_out(release: str) -> HeldOut:
    """The suite of a release, by its name ("0.2").

    Raises:
        ValueError: There is none.
    """
    return load_toml(release, "held-out", HeldOut)


def releases() -> list[str]:
    """Releases that have a suite, the oldest first."""
    return preset_names("held-out")


def reserved_by(seed: int) -> HeldOut | None:
    """The held-out suite that a seed is of."""
    suites = map(load_held_out, releases())
    return next((suite for suite in suites if suite.seed <= seed < suite.seed + SEEDS), None)


def unreserved(seed: int) -> int:
    """A seed that no held-out suite has.

    Raises:
        ValueError: One has it.
    """
    if suite := reserved_by(seed):
        raise ValueError(
            f"seed {seed} is of the held-out suite of {suite.release}, on which nothing is trained, tuned or "
            f"chosen; give one below {suite.seed} or from {suite.seed + SEEDS} on"
        )
    return seed
