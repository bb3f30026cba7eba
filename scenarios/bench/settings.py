"""What the flights of a benchmark have in common, and what of their scenarios is replaced."""

from dataclasses import asdict, dataclass

from quadsim.flight.scenario import Scenario, changed


@dataclass(frozen=True)
class FlightSettings:
    """How every cell is simulated."""

    seeds: int = 1
    """Flights in each cell; flight i has the i-th child of `seed`."""
    seed: int = 0
    """Seed of everything random."""
    rate_hz: float = 200.0
    """Samples per second."""
    tuning: str | None = None
    """Tuned parameters in place of the shipped ones: a shipped domain or a file of `quadsim tune`; estimators
    without a table in it keep theirs."""

    def __post_init__(self) -> None:
        """Check the number of flights."""
        if self.seeds < 1:
            raise ValueError(f"seeds is {self.seeds}; at least one flight is needed")


@dataclass(frozen=True)
class ScenarioChanges:
    """Fields that replace those of every scenario; None keeps the scenario's own."""

    duration_s: float | None = None
    """Length of the flights [s]."""
    vehicle: str | None = None
    """A shipped name or a TOML file; shipped parameters of filters are those tuned for it, if there are such,
    and ekf-drag has its drag."""
    imu: str | None = None
    """A shipped name or a TOML file."""
    external: str | None = None
    """External sensor, for example "ideal"."""
    engine: str | None = None
    """Integrator of the motion: "auto", "mujoco" or "compiled"."""

    def of(self, scenario: Scenario) -> Scenario:
        """A scenario with these fields, checked.

        Raises:
            ValueError: A value that the field cannot have.
        """
        return changed(scenario, {key: value for key, value in asdict(self).items() if value is not None})
