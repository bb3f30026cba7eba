"""What the flights of a benchmark have in common."""

from dataclasses import dataclass


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
