"""The recommended estimators, as found with the held-out suite."""

import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

import tomli_w

from quadsim.runs.files import write_whole

FILE = Path(__file__).with_suffix(".toml")


class Recommendation(NamedTuple):
    """Content of `recommendation.toml`, which the script of the results page writes."""

    release: str  #: whose held-out suite was flown
    command: str  #: what flew it
    date: str
    sentence: str  #: what to fly, on which condition

    @property
    def elsewhere(self) -> str:
        """A sentence for reports of other flights."""
        return (
            f"The recommendation of release {self.release} is: {self.sentence} It comes from a held-out "
            "suite that varies all of these conditions and the wind, and it counts crashes before errors."
        )


@cache
def recommendation() -> Recommendation:
    """Load the shipped recommendation."""
    return Recommendation(**tomllib.loads(FILE.read_text("utf-8")))


def save_recommendation(found: Recommendation) -> None:
    """Write the recommendation."""
    head = "# Written by the command that makes docs/results.md, from the flights of the held-out suite.\n"
    write_whole(FILE, head + tomli_w.dumps(found._asdict()))
    recommendation.cache_clear()
