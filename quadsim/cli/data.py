"""Verbs that make data and take it elsewhere: `generate`, `dataset`, `export`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from ..config.toml import merged, parse
from ..runs.console import output as console
from ..runs.console import pool_of, progress_bar
from .options import LearningSeed, Pool, RecipeFields, Sampling, fields_of

dataset_app = typer.Typer(help="Look at a dataset, check it, plot it.", no_args_is_help=True)


def generate(
    out: Annotated[Path, typer.Option(help="Where the dataset goes, for example data/train.zarr.")],
    flights: Annotated[int, typer.Option(min=1, help="Number of flights.")] = 35,
    duration: Annotated[float, typer.Option(min=0.1, help="Length of each flight in seconds.")] = 100.0,
    recipe: Annotated[
        str, typer.Option(help="What to simulate: a shipped recipe or a TOML file.")
    ] = "hummingbird",
    set_: RecipeFields = None,
    seed: LearningSeed = 0,
    workers: Pool = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what is at --out.")] = False,
) -> None:
    """Generate labelled synthetic flights: IMU samples and everything that was true.

    The defaults are the paper's size, 35 flights of 100 s at 200 Hz, and take some ten seconds. A killed run
    resumes when the same command is given again; the number of workers changes nothing.

    Example: quadsim generate --flights 4 --duration 20 --out data/small.zarr
    """
    from ..dataset.generation import generate as generate_dataset
    from ..dataset.reading import dataset_info
    from ..flight.recipe import Recipe, flight_config, load_recipe

    changes = fields_of(set_)
    rate = parse({name: changes.pop(name) for name in ("rate",) if name in changes}, Sampling, "--set").rate
    changed = merged(load_recipe(recipe).model_dump(mode="json"), changes)
    config = flight_config(parse(changed, Recipe, "--set"))
    with pool_of(workers) as (count, executor), progress_bar("generate", "flights") as progress:
        path = generate_dataset(
            config,
            flights,
            duration,
            out,
            seed=seed,
            rate_hz=rate,
            workers=count,
            executor=executor,
            progress=progress,
            overwrite=overwrite,
        )
    info = dataset_info(path)
    early = f", {info['flights_ended_early']} of them ended early" if info["flights_ended_early"] else ""
    console.print(
        f"{path}: {info['flights']} flights of {info['duration_s']:g} s at {info['rate_hz']:g} Hz{early}, "
        f"roll SD {info['roll_sd_deg']:.1f}°, pitch SD {info['pitch_sd_deg']:.1f}°, "
        f"largest tilt {info['max_tilt_deg']:.0f}°, {info['size_MB']:.1f} MB",
        soft_wrap=True,
    )


@dataset_app.command("info")
def dataset_info_verb(path: Annotated[Path, typer.Argument(help="A dataset.")]) -> None:
    """Say what a dataset holds."""
    from ..dataset.reading import dataset_info

    info = dataset_info(path)
    table = Table(show_header=False)
    for key, value in info.items():
        if key != "config":
            table.add_row(key, f"{value:.3f}" if isinstance(value, float) else str(value))
    console.print(table)


@dataset_app.command("verify")
def dataset_verify(path: Annotated[Path, typer.Argument(help="A dataset.")]) -> None:
    """Compare every file with its digest and every number with its checksum; find non-finite numbers.

    Opening a dataset compares names, dimensions, shapes and units, and the numbers with their checksums only
    when the size or the time stamp of a file has changed.
    """
    from ..dataset.reading import verify

    with progress_bar("verify", "flights") as progress:
        total = verify(path, progress)
    console.print(f"{path}: all {total} flights are whole", soft_wrap=True)


@dataset_app.command("plot")
def dataset_plot(
    path: Annotated[Path, typer.Argument(help="A dataset.")],
    out: Annotated[Path, typer.Option(help="Where the picture goes.")] = Path("dataset.png"),
) -> None:
    """Draw the distributions of sensors and attitude (the paper's Fig. 3) and one flight."""
    from ..dataset.figures import plot

    plot(path, out)
    console.print(f"{out}", soft_wrap=True)


def export(
    source: Annotated[
        Path, typer.Argument(help="A dataset; or weights: a file, or a name of quadsim list weights.")
    ],
    out: Annotated[Path, typer.Option(help="What to write; it must not exist yet.")],
    format: Annotated[
        str,
        typer.Option(
            help="Of a dataset: netcdf, parquet, csv (EuRoC folders) or rosbag2. "
            "Of weights: nir (runs in Norse and snnTorch), c99 (header and source) or onnx (att-rnn)."
        ),
    ],
) -> None:
    """Write a dataset or a trained network in a format of other tools.

    Example: quadsim export att-snn --format c99 --out firmware/att_snn
    """
    from estimators.export.formats import FORMATS, export_weights
    from estimators.networks.weights_file import END, shipped_controllers, shipped_names

    from ..dataset.export import export as export_dataset

    names_weights = source.suffix == END or str(source) in (*shipped_names(), *shipped_controllers())
    if names_weights or format in FORMATS:
        export_weights(source, out, format)
    else:
        with progress_bar("export", "flights") as progress:
            export_dataset(source, out, format, progress)
    console.print(f"{out}: {source} as {format}", soft_wrap=True)
