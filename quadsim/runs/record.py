"""The record of a run: version, commit, command, date and duration."""

import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from .files import read_json, write_json
from .fingerprint import ROOT

FILE = "run.json"


@dataclass(frozen=True)
class RunRecord:
    """Describes how and when a folder of results was made."""

    version: str
    commit: str
    """Commit of the code; empty without a repository, and ending in "-dirty" with uncommitted changes."""
    command: str
    date: str
    """End of the run, UTC, to the second."""
    wall_s: float
    """Duration, including interrupted runs that this run resumed [s]."""


@contextmanager
def recorded(folder: Path) -> Iterator[None]:
    """Write `run.json` to a folder, if it exists, at the end of the block or at an interruption."""
    began, folder = time.perf_counter(), folder.expanduser()
    try:
        yield
    finally:
        if folder.is_dir():
            now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S")
            new = RunRecord(version("quadsim"), commit(), command_line(), now, time.perf_counter() - began)
            old = load_record(folder)
            if old and replace(old, date=new.date, wall_s=new.wall_s) == new:
                new = replace(new, wall_s=new.wall_s + old.wall_s)
            write_json(folder / FILE, asdict(new))


def load_record(folder: Path) -> RunRecord | None:
    """Return the record of a folder; None if there is none."""
    try:
        return RunRecord(**read_json(folder.expanduser() / FILE))
    except (OSError, ValueError, TypeError):
        return None


def command_line() -> str:
    """Return the command that started this process."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def commit() -> str:
    """Return the commit of the code, with "-dirty" for uncommitted changes; empty outside its repository."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(ROOT), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()

    try:
        ours = Path(git("rev-parse", "--show-toplevel") or "/").samefile(ROOT)
        return git("describe", "--always", "--dirty", "--exclude=*") if ours else ""
    except OSError:  # no git
        return ""
