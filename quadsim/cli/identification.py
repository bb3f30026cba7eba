"""The command `identify`: constants of a vehicle from flights, or noise and bias of an IMU at rest."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from .options import Imu, Mount


def identify(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Datasets or logs of flights with rotor speeds. With --still: one log of a sensor at rest."
        ),
    ],
    vehicle: Annotated[
        str,
        typer.Option(
            help="Vehicle whose mass and geometry are used and from whose constants the fit starts: a "
            "shipped name, or a TOML file with the mass and the rotor positions that you measured."
        ),
    ] = "hummingbird",
    out: Annotated[
        Path | None,
        typer.Option(
            help="TOML file to write. Default: mine.toml for a vehicle; my-imu.toml with --still. The "
            "command also writes a picture with the same name."
        ),
    ] = None,
    rate: Annotated[
        float, typer.Option(min=110, max=2000, help="Sample rate to which logs are resampled, in Hz.")
    ] = 500.0,
    mount: Mount = None,
    still: Annotated[
        bool,
        typer.Option(
            "--still", help="Measure noise and biases of an IMU at rest, instead of fitting a vehicle."
        ),
    ] = False,
    imu: Imu = None,
) -> None:
    """Fit thrust, drag, motor lag and inertia of a vehicle to flights.

    Weigh the vehicle and measure the rotor positions first, because a flight determines only force per mass.
    Fly aggressively, turn the heading, and fly fast enough for drag to matter. The recordings must contain
    rotor speeds. To fit the drag, they must also contain attitude and position. If the 95 % confidence
    interval of a constant is wider than ±5 %, the constant keeps its initial value, and the command says so.

    With --still, the command computes the Allan variance of a log at rest and writes an IMU file for
    `quadsim generate --set imu=FILE`. Biases and noise densities need 10 s at rest. A bias random walk needs
    at least 60 s, and preferably an hour. The time constant of the random walk needs a log several times as
    long as the time constant. If the log is too short for a coefficient, the file omits the coefficient, and
    the command says so.

    Example: quadsim identify data/flights.zarr --vehicle hummingbird --out mine.toml

    Example: quadsim identify still.ulg --still --out my-imu.toml
    """
    if still:
        if len(files) > 1:
            raise ValueError(f"--still takes one log, not {len(files)}")
        from ..imu.spec import load_imu
        from ..logs import read_recording
        from ..logs.allan import calibrate, show_calibration

        out = out or Path("my-imu.toml")
        if out.suffix != ".toml" or out.absolute() == files[0].absolute():
            raise ValueError(f"{out}: the IMU file must end in .toml and must not be the log")
        _refuse_another_kind(out, load_imu, "IMU")
        show_calibration(calibrate(read_recording(files[0], mount=mount, imu=imu)), out)
        return
    from ..identify.fit_report import identify_files
    from ..vehicle import load_vehicle

    out = out or Path("mine.toml")
    _refuse_another_kind(out, load_vehicle, "vehicle")
    identify_files(files, vehicle, out, rate, mount)


def _refuse_another_kind(out: Path, load: Callable[[Path], object], kind: str) -> None:
    """Refuse to replace a file that does not describe a vehicle or an IMU, whichever is to be written."""
    if out.exists():
        try:
            load(out)
        except ValueError as error:
            raise ValueError(f"{out} exists and does not describe a {kind}: choose another --out") from error
