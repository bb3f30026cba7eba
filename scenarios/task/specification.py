"""What a task is: its data, made with held-out seeds, its closed loop, its metrics and its rules."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from pydantic import Field

from quadsim.config.ranges import Between, Duration, SampleRate
from quadsim.config.toml import Strict, load_toml
from quadsim.flight.recipe import Variant
from quadsim.held_out import SEEDS, load_held_out
from quadsim.runs.fingerprint import fingerprint

from ..bench.experiment import Experiment, Knowledge, load_experiment, of_release

Progress = Callable[[int, int, str], None]
"""progress(done, total, what is next)."""
SEEDS_EACH = 1000
"""Seeds that each part of the data may take."""
ROTORPY, BROAD = "rotorpy", "broad"
"""Parts of the data that are not of a recipe."""


class Simulated(Variant):
    """Flights of a recipe."""

    flights: Annotated[int, Between(1, SEEDS_EACH)]
    duration_s: Duration
    """Length of each flight [s]."""


class Task(Strict):
    """A task: its data, metrics, limits and rules."""

    version: str
    """Its name and version; what an entry got under another one is not comparable."""
    description: str
    release: str
    """Release whose held-out seeds all simulated flights have."""
    closed_loop: str
    """The experiment that is flown: held-out, or a TOML file."""
    rate_hz: SampleRate
    """Samples per second of all data."""
    most_ms: Annotated[float, Between(1e-3, 1e4, "ms")]
    """Time limit per sample of one vehicle [ms]."""
    skip_s: Annotated[float, Between(0.0, 60.0, "s")]
    """Time at the start of simulated flights that is not scored [s]."""
    recipes: dict[str, Simulated]
    """Simulated flights, by the name of their part."""
    rotorpy_s: Duration | None = None
    """Length of the flights in RotorPy, four of each of its airframes [s]; left out, there are none."""
    broad_trials: Annotated[int, Between(0, 1000)] = 0
    """Trials of BROAD, from the user's own folder; without one of them this part has no mean."""
    digests: dict[str, str] = Field(default={})
    """Of the numbers of parts, see `data.digest_of`; those that are left out are not checked."""
    metrics: dict[str, str]
    """Description of each metric."""
    rules: tuple[str, ...]
    """Rules for entries."""

    @property
    def parts(self) -> list[str]:
        """Names of what estimators run on without a loop."""
        others = {ROTORPY: self.rotorpy_s, BROAD: self.broad_trials}
        return [*self.recipes, *(name for name, given in others.items() if given)]

    def seed_of(self, part: str) -> int:
        """The first seed of a part's data: it is in the range that the release reserves."""
        offset = SEEDS_EACH * (1 + self.parts.index(part))
        if offset + SEEDS_EACH > SEEDS:
            raise ValueError(f"parts: {len(self.parts)} are more than the release has seeds for")
        return load_held_out(self.release).seed + offset

    def experiment(self, given: tuple[Knowledge, ...]) -> Experiment:
        """The closed loop for entries that are given these things."""
        found = load_experiment(self.closed_loop)
        found = of_release(found, self.release) if found.held_out else found
        return found.model_copy(update={"given": given})

    @property
    def fingerprint(self) -> str:
        """Digest of all that it says."""
        return fingerprint(
            self.model_dump(mode="json"), load_experiment(self.closed_loop).model_dump(mode="json")
        )


def load_task(source: str | Path) -> Task:
    """A shipped task ("attitude-1"), or the one in a TOML file.

    Raises:
        ValueError: One line with the file, the key, its value and what is allowed.
    """
    return load_toml(source, "tasks", Task)
