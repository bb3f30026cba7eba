"""A log with its report."""

from quadsim.logs import read_log


def reported(path, **choices):
    """The dataset of a log, and what reading it found."""
    log = read_log(path, **choices)
    return log, log.attrs["log"]
