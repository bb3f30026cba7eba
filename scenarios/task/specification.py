"""The definition of a task: data with held-out seeds, closed loop, metrics and rules."""

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
"""Called as progress(finished, total, name of the next part)."""
SEEDS_EACH = 1000
"""Number of seeds reserved for each part of the data."""
ROTORPY, BROAD = "rotorpy", "broad"
"""Parts of the data that are not generated from recipes."""


class Simulated(Variant):
    """Simulated flights of a recipe."""

    flights: Annotated[int, Between(1, SEEDS_EACH)]
    duration_s: Duration
    """Length of each flight [s]."""


class Task(Strict):
    """A task: its data, metrics, limits and rules."""

    version: str
    """Name and version of the task. Results of different versions are not comparable."""
    description: str
    release: str
    """Release whose held-out seeds are used for all simulated flights."""
    closed_loop: str
    """Experiment in closed loop: held-out, or a TOML file."""
    rate_hz: SampleRate
    """Samples per second of all data."""
    most_ms: Annotated[float, Between(1e-3, 1e4, "ms")]
    """Time limit per sample of one vehicle [ms]."""
    skip_s: Annotated[float, Between(0.0, 60.0, "s")]
    """Time at the start of simulated flights that is not scored [s]."""
    recipes: dict[str, Simulated]
    """Simulated flights, by the name of the part."""
    rotorpy_s: Duration | None = None
    """Length of the RotorPy flights, four for each airframe [s]; by default, there are none."""
    broad_trials: Annotated[int, Between(0, 1000)] = 0
    """Trials of BROAD, from the user's folder. If one is missing, this part has no mean."""
    digests: dict[str, str] = Field(default={})
    """Digests of the data of parts, see `data.digest_of`; parts without a digest are not checked."""
    metrics: dict[str, str]
    """Description of each metric."""
    rules: tuple[str, ...]
    """Rules for entries."""

    @property
    def parts(self) -> list[str]:
        """Names of the parts of recorded data."""
        others = {ROTORPY: self.rotorpy_s, BROAD: self.broad_trials}
        return [*self.recipes, *(name for name, given in others.items() if given)]

    def seed_of(self, part: str) -> int:
        """Return the first seed of a part's data, within the range that the release reserves."""
        offset = SEEDS_EACH * (1 + self.parts.index(part))
        if offset + SEEDS_EACH > SEEDS:
            raise ValueError(f"parts: {len(self.parts)} are more than the release has seeds for")
        return load_held_out(self.release).seed + offset

    def experiment(self, given: tuple[Knowledge, ...]) -> Experiment:
        """Return the experiment in closed loop for entries that are given these quantities."""
        found = load_experiment(self.closed_loop)
        found = of_release(found, self.release) if found.held_out else found
        return found.model_copy(update={"given": given})

    @property
    def fingerprint(self) -> str:
        """Digest of the whole task."""
        return fingerprint(
            self.model_dump(mode="json"), load_experiment(self.closed_loop).model_dump(mode="json")
        )


def load_task(source: str | Path) -> Task:
    """Load a task by its shipped name ("attitude-1") or from a TOML file.

    Raises:
        ValueError: The file is invalid; the message names the key, its value and the allowed values.
    """
    return load_toml(source, "tasks", Task)
