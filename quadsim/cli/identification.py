"""The command `identify`: constants of a vehicle from flights, or noise and bias of an IMU at rest."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from .options import Imu, Mount


def identify(
    files: Annotated[
        list[Path],
        typer.Argument(help="Datasets or logs of flights with rotor speeds; with --still: a log at rest."),
    ],
    vehicle: Annotated[
        str,
        typer.Option(
            help="Initial vehicle: a shipped name, or a TOML file with your mass and rotor positions."
        ),
    ] = "hummingbird",
    out: Annotated[
        Path | None,
        typer.Option(
            help="TOML file to write: the vehicle (default: mine.toml), or with --still the IMU (default: "
            "my-imu.toml). A picture gets the same name."
        ),
    ] = None,
    rate: Annotated[
        float, typer.Option(min=110, max=2000, help="Sample rate of the resampled logs, in Hz.")
    ] = 500.0,
    mount: Mount = None,
    still: Annotated[
        bool, typer.Option("--still", help="The sensor is at rest: measure its noise and biases instead.")
    ] = False,
    imu: Imu = None,
) -> None:
    """Fit thrust, drag, motor lag and inertia of a vehicle to flights.

    First weigh the vehicle and measure the rotor positions, because flights determine only force per mass.
    Fly aggressively, turn the heading, and fly fast to excite the drag. The flights need rotor speeds; to fit
    the drag, they also need attitude and position. A constant whose 95 % interval is wider than 5 % keeps its
    value, and the output names it.

    With --still, the command computes an IMU file for `generate --set imu=FILE` from the Allan variance. A
    bias and a noise density need 10 s at rest. A bias random walk needs at least 60 s; an hour is better.
    The time constant of the random walk needs a log several times as long as itself. If the log is too
    short for a coefficient, the file omits it and the output names it.

    Example: quadsim identify data/flights.zarr --vehicle hummingbird --out mine.toml

    Example: quadsim identify still.ulg --still --out my-imu.toml
    """
    if still:
        if len(files) > 1:
            raise ValueError(f"--still is of one log, not of {len(files)}")
        from ..imu.spec import load_imu
        from ..logs import read_recording
        from ..logs.allan import calibrate, show_calibration

        out = out or Path("my-imu.toml")
        if out.suffix != ".toml" or out.absolute() == files[0].absolute():
            raise ValueError(f"{out}: an IMU file ends in .toml, and is not the log")
        _refuse_another_kind(out, load_imu, "IMU")
        show_calibration(calibrate(read_recording(files[0], mount=mount, imu=imu)), out)
        return
    from ..identify.fit_report import identify_files
    from ..vehicle import load_vehicle

    out = out or Path("mine.toml")
    _refuse_another_kind(out, load_vehicle, "vehicle")
    identify_files(files, vehicle, out, rate, mount)


def _refuse_another_kind(out: Path, load: Callable[[Path], object], kind: str) -> None:
    """Let a file be replaced by one of its kind alone."""
    if out.exists():
        try:
            load(out)
        except ValueError as error:
            raise ValueError(
                f"{out} is there already, and describes no {kind}: give another --out"
            ) from error
