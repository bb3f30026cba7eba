"""The one recommendation: what to fly by the held-out suite, which trained, tuned and chose nothing."""

from functools import cache
from pathlib import Path

import tomli_w
from pydantic import Field

from quadsim.config.toml import Strict, parse, read_toml
from quadsim.runs.files import write_whole

FILE = Path(__file__).with_suffix(".toml")


class Recommendation(Strict):
    """The file `recommendation.toml`, which the page of the held-out suite writes."""

    release: str = Field(description="Release whose held-out suite was flown.")
    command: str = Field(description="What flew it.")
    date: str = Field(description="When.")
    sentence: str = Field(description="What to fly, on which condition.")

    @property
    def elsewhere(self) -> str:
        """A sentence for reports of other flights."""
        return (
            f"In general: {self.sentence} (Held-out suite of release {self.release}, which varies all of "
            "these and the wind; crashes count before errors.)"
        )


@cache
def recommendation() -> Recommendation:
    """The recommendation that ships."""
    return parse(read_toml(FILE.read_text("utf-8"), FILE.name), Recommendation, FILE.name)


def save_recommendation(found: Recommendation) -> None:
    """Write the file that `recommendation` reads."""
    head = "# Written by the command that makes docs/results.md, from the flights of the held-out suite.\n"
    write_whole(FILE, head + tomli_w.dumps(found.model_dump()))
    recommendation.cache_clear()
