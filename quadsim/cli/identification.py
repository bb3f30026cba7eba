"""`quadsim identify`: a vehicle's constants, and what its sensors add, from flights or at rest."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from ..runs.console import output
from ..runs.files import save_figure
from .logs import calibrate_imu
from .options import Imu, Mount

if TYPE_CHECKING:
    import xarray as xr

    from ..identify import Flight

AXES = ("x", "y", "z")


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
    from ..identify import flights_of
    from ..identify import identify as fit
    from ..identify.report import draw_fit, write_vehicle
    from ..vehicle import load_vehicle

    start = load_vehicle(vehicle)
    if out.suffix != ".toml":
        raise ValueError(f"{out}: a vehicle file ends in .toml")
    found_in = {file: flights_of(_read(file, rate, mount)) for file in files}
    for file, each in found_in.items():
        if not each:
            raise ValueError(f"{file}: no 5 s without a missing sample")
    flights = [flight for each in found_in.values() for flight in each]
    _show_noise(flights, out)
    turning = [flight for flight in flights if flight.has_rotors]
    for file, each in found_in.items():
        if turning and not any(flight.has_rotors for flight in each):
            output.print(f"{file}: no rotor speeds in rad/s, left out", style="yellow", markup=False)
    if not turning:
        output.print(
            f"no rotor speeds in rad/s: noise and vibration alone, and no {out}", style="yellow", markup=False
        )
        return
    found = fit(turning, start)
    table = Table("constant", "unit", "start", "fitted", "± (95 %)", "used")
    for each in found.constants:
        used = "yes" if each.identified else "no"
        width = f"{each.half_width / each.fitted:.1%}" if each.identified else f"{each.half_width:.2g}"
        table.add_row(each.path, each.unit, f"{each.start:.4g}", f"{each.fitted:.4g}", width, used)
    output.print(table)
    for line in found.missing:
        output.print(f"not identified: {line}", style="yellow", markup=False, soft_wrap=True)
    write_vehicle(found, out, [str(file) for file in files])
    picture = save_figure(out.with_suffix(".png"), draw_fit(found), dpi=120)
    low = found.explained.min()
    output.print(
        f"{out}: for --vehicle {out}; the model explains {low:.1%} or more of each signal ({picture})",
        soft_wrap=True,
        highlight=False,
    )


def _read(file: Path, rate_hz: float, mount: str | None) -> "xr.Dataset":
    """A dataset, or a log as one."""
    if file.suffix == ".zarr":
        from ..dataset.reading import open_dataset

        return open_dataset(file)
    from ..logs import read_log

    return read_log(file, rate_hz, mount=mount)


def _show_noise(flights: "list[Flight]", out: Path) -> None:
    """Table and picture of noise and vibration of the longest flight."""
    from ..identify.noise import RESTING, at_rest, in_the_air, noise_in_flight
    from ..identify.report import draw_noise

    longest = max(flights, key=lambda flight: len(flight.gyro))
    air, rest = in_the_air(longest), at_rest(longest)
    sensors = [noise_in_flight(each, air.rate_hz) for each in (air.gyro, air.accel)]
    still = (
        None
        if rest is None
        else [noise_in_flight(each, rest.rate_hz, RESTING) for each in (rest.gyro, rest.accel)]
    )
    table = Table("in flight", "unit", *AXES)
    for k, (name, unit) in enumerate((("gyroscope", "rad/s"), ("accelerometer", "m/s²"))):
        each = sensors[k]
        table.add_row(f"{name}, RMS above 25 Hz", unit, *(f"{value:.3g}" for value in each.shaking))
        table.add_row(
            f"{name}, density at 25 to 60 Hz", f"{unit}/√Hz", *(f"{value:.3g}" for value in each.noise)
        )
        if still is not None:
            table.add_row(
                f"{name}, noise at rest", f"{unit}/√Hz", *(f"{value:.3g}" for value in still[k].noise)
            )
        if each.line_hz == each.line_hz:
            table.add_row(
                f"{name}, line at {each.line_hz:.0f} Hz", unit, *(f"{value:.3g}" for value in each.line)
            )
    output.print(table)
    figure = draw_noise(sensors[0], sensors[1], None if still is None else (still[0], still[1]))
    picture = save_figure(out.with_name(f"{out.stem}-noise.png"), figure, dpi=120)
    output.print(f"{picture}: spectra of the readings", soft_wrap=True, highlight=False)
