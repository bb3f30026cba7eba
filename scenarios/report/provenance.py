"""How a report came about, for its foot: version, commit, command, date, duration, flights and their cost."""

from quadsim.runs.record import RunRecord

from ..bench.cost import cost_of, hours
from ..bench.runner import Results


def provenance(results: Results, record: RunRecord | None) -> dict[str, str]:
    """What is known of a run, by its heading; without a record what the results themselves say."""
    found = {"flights": f"{cost_of(results)}."} if results.flights else {}
    if record is None:
        return found
    commit = f", commit {record.commit}" if record.commit else ""
    took = f"{record.date} UTC, after {hours(record.wall_s)}"
    return found | {
        "finished": took,
        "version": f"quadsim {record.version}{commit}",
        "command": record.command,
    }
