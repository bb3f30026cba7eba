"""`quadsim identify`: a vehicle's constants, and what its sensors add, from flights or at rest."""

from pathlib import Path
from typing import Annotated

import typer

from .logs import calibrate_imu
from .options import Imu, Mount


def identify(
    files: Annotated[
        list[Path],
        typer.Argument(help="Datasets of flights, or logs with rotor speeds; with --still logs at rest."),
    ],
    vehicle: Annotated[
        str, typer.Option(help="Where to begin: a shipped vehicle or a TOML file with your mass and hubs.")
    ] = "hummingbird",
    out: Annotated[
        Path, typer.Option(help="File of the vehicle, with --still of the IMU; pictures get its name.")
    ] = Path("mine.toml"),
    rate: Annotated[
        float, typer.Option(min=110, max=2000, help="Samples per second that logs are read at.")
    ] = 500.0,
    mount: Mount = None,
    still: Annotated[
        bool, typer.Option("--still", help="The sensor lies still: measure its noise and biases instead.")
    ] = False,
    gravity: Annotated[
        float, typer.Option(help="With --still: gravity where it was recorded, in m/s².")
    ] = 9.81,
    imu: Imu = None,
    bias_only: Annotated[
        bool, typer.Option("--bias-only", help="With --still: the biases alone, for which 3 s are enough.")
    ] = False,
) -> None:
    """Fit thrust, drag, lag and inertia of a vehicle file to flights, and show vibration and noise.

    Weigh the vehicle and measure where the rotors sit first: flights tell force per mass alone. Fly
    aggressively, turn the heading, and fly fast for the drag. Rotor speeds are needed; attitude and position
    for the drag. A constant whose 95 % interval is wider than 5 % keeps its value, and is named.

    With --still, an IMU file for `generate --set imu=FILE` is written, by the Allan variance. A bias needs
    3 s at rest, a noise density 10 s, a bias random walk 60 s and to be sure an hour, its time constant a log
    several times as long as itself. What the logs are too short for is left out and named.

    Example: quadsim identify data/flights.zarr --vehicle hummingbird --out mine.toml

    Example: quadsim identify still.ulg --still --out my-imu.toml
    """
    if still:
        calibrate_imu(files, out, gravity, mount, imu, bias_only)
        return
    from ..identify.report import identify_files

    identify_files(files, vehicle, out, rate, mount)
