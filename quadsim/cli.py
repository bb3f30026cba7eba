"""The command line. Each verb is thin: it parses, calls one function of the library, and says what came out.

This is the only module of `quadsim` that imports the packages above it: inside each verb, so that `--help` is
fast.
"""

import logging
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

app = typer.Typer(
    name="quadsim",
    help="Fly a MuJoCo quadrotor on spiking, learned and classical attitude estimators: see which to trust.",
    epilog="Start here: quadsim demo --out reports/demo",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
dataset_app = typer.Typer(help="Look at a dataset, check it, plot it.", no_args_is_help=True)
app.add_typer(dataset_app, name="dataset")
console = Console()

Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Worker processes; one per CPU when left out.")]
Rate = Annotated[float, typer.Option(min=50, max=2000, help="Samples per second.")]


@contextmanager
def progress_bar(title: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar as a callback (done, total), with units per second and time left."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(f"{unit}, {{task.fields[speed]}}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=None, speed="")

        def update(done: int, total: int) -> None:
            speed = bar.tasks[0].speed
            bar.update(task, completed=done, total=total, speed=f"{speed:.2g} a second" if speed else "")

        yield update


@app.command()
def generate(
    out: Annotated[Path, typer.Option(help="Where the dataset goes, for example data/train.zarr.")],
    flights: Annotated[int, typer.Option(min=1, help="Number of flights.")] = 35,
    duration: Annotated[float, typer.Option(min=0.1, help="Length of each flight in seconds.")] = 100.0,
    recipe: Annotated[
        str, typer.Option(help="What is flown: a shipped recipe or a TOML file.")
    ] = "hummingbird",
    vehicle: Annotated[
        str | None, typer.Option(help="Another vehicle: a shipped name or a TOML file.")
    ] = None,
    imu: Annotated[str | None, typer.Option(help="Another IMU: a shipped name or a TOML file.")] = None,
    rate: Rate = 200.0,
    seed: Seed = 0,
    workers: Workers = None,
    cluster: Annotated[str | None, typer.Option(help="Address of a Dask scheduler to run on.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what is at --out.")] = False,
) -> None:
    """Generate labelled synthetic flights: IMU samples and everything that was true.

    The defaults are the paper's size, 35 flights of 100 s at 200 Hz, and take some ten seconds. A killed run
    goes on where it stopped when the same command is given again; the number of workers changes nothing.

    Example: quadsim generate --flights 4 --duration 20 --out data/small.zarr
    """
    from .dataset import dataset_info
    from .dataset import generate as generate_dataset
    from .recipe import flight_config, load_recipe

    changes = {name: value for name, value in {"vehicle": vehicle, "imu": imu}.items() if value is not None}
    config = flight_config(load_recipe(recipe).model_copy(update=changes))
    with executor_of(cluster) as executor, progress_bar("generate", "flights") as progress:
        path = generate_dataset(
            config,
            flights,
            duration,
            out,
            seed=seed,
            rate_hz=rate,
            workers=workers,
            executor=executor,
            progress=progress,
            overwrite=overwrite,
        )
    info = dataset_info(path)
    console.print(
        f"{path}: {info['flights']} flights of {info['duration_s']:g} s at {info['rate_hz']:g} Hz, "
        f"roll SD {info['roll_sd_deg']:.1f}°, pitch SD {info['pitch_sd_deg']:.1f}°, "
        f"largest tilt {info['max_tilt_deg']:.0f}°, {info['size_MB']:.1f} MB",
        soft_wrap=True,
    )


@dataset_app.command("info")
def dataset_info_verb(path: Annotated[Path, typer.Argument(help="A dataset.")]) -> None:
    """Say what a dataset holds."""
    from .dataset import dataset_info

    info = dataset_info(path)
    table = Table(show_header=False)
    for key, value in info.items():
        if key != "config":
            table.add_row(key, f"{value:.3f}" if isinstance(value, float) else str(value))
    console.print(table)


@dataset_app.command("verify")
def dataset_verify(path: Annotated[Path, typer.Argument(help="A dataset.")]) -> None:
    """Recompute the checksums and look for numbers that are not finite."""
    from .dataset import verify

    with progress_bar("verify", "flights") as progress:
        total = verify(path, progress)
    console.print(f"{path}: all {total} flights are whole", soft_wrap=True)


@dataset_app.command("plot")
def dataset_plot(
    path: Annotated[Path, typer.Argument(help="A dataset.")],
    out: Annotated[Path, typer.Option(help="Where the picture goes.")] = Path("dataset.png"),
) -> None:
    """Draw the distributions of sensors and attitude (the paper's Fig. 3) and one flight."""
    from .figures import plot

    plot(path, out)
    console.print(f"{out}", soft_wrap=True)


@app.command()
def design(
    vehicle: Annotated[str, typer.Option(help="A shipped vehicle or a TOML file.")] = "hummingbird",
    rate: Rate = 200.0,
    delay: Annotated[
        float, typer.Option(min=0, help="Delay of the attitude estimate in milliseconds.")
    ] = 15.0,
) -> None:
    """Design the controller's gains from phase margins, and print them with the margins they leave.

    Paste the gains into the vehicle's TOML file; a file without them has them designed when first needed.
    """
    from .design import design as design_gains
    from .design import loop_margins
    from .vehicle import load_vehicle

    airframe = load_vehicle(vehicle)
    gains = design_gains(airframe, rate, delay / 1e3)
    table = Table("loop", "crossover, rad/s", "phase margin, °", "gain margin, dB", "delay margin, ms")
    for name, m in loop_margins(airframe, gains, rate, delay / 1e3).items():
        table.add_row(
            name, f"{m.crossover:.2f}", f"{m.phase_deg:.1f}", f"{m.gain_db:.1f}", f"{m.delay_ms:.0f}"
        )
    console.print(f"{vehicle}, {rate:g} Hz, estimator delay {delay:g} ms, rotor lag included")
    console.print(table)
    console.print("\\[controller]")
    for name, value in gains.model_dump().items():
        console.print(f"{name} = {value:.4g}", highlight=False)


@contextmanager
def executor_of(cluster: str | None) -> Iterator[Executor | None]:
    """The executor of a Dask cluster, or None for processes of our own."""
    if cluster is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise ValueError("--cluster needs Dask: pip install 'quadsim[cluster]'") from None
    try:
        client = Client(cluster, timeout="10s")
    except (OSError, ValueError) as error:
        raise ValueError(f"no Dask scheduler answers at {cluster}: {error}") from None
    with client:
        yield client.get_executor()


def main() -> None:
    """Run the command line: a user's mistake is one line and exit code 2."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    try:
        app()
    except (ValueError, OSError) as error:
        message = str(error) or type(error).__name__
        Console(stderr=True).print(
            f"quadsim: {' '.join(message.split())}", style="red", markup=False, soft_wrap=True
        )
        sys.exit(2)
    except KeyboardInterrupt:
        Console(stderr=True).print("quadsim: interrupted; the same command goes on where this one stopped")
        sys.exit(130)


if __name__ == "__main__":
    main()
