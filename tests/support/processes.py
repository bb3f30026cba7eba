"""Processes as the system sees them."""

import os
import time
from pathlib import Path


def square(number: int, deadly: int) -> int:
    """The square, of all but one number that ends the process."""
    if number == deadly:
        os._exit(1)
    return number**2


def await_true(condition, seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def children(pid: int) -> list[int]:
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
