"""Commands that generate and export data: `generate`, `export`."""

from pathlib import Path
from typing import Annotated

import typer

from ..runs.console import print_table, progress_bar, say
from .options import Force, Imu, LearningSeed, Mount, Seed, Truth, Workers, fields_of, settings_of


def generate(
    out: Annotated[Path, typer.Option(help="Folder for the new dataset, for example data/train.zarr.")],
    flights: Annotated[int, typer.Option(min=1, help="Number of flights.")] = 35,
    duration: Annotated[float, typer.Option(min=0.1, help="Length of each flight in seconds.")] = 100.0,
    recipe: Annotated[
        str, typer.Option(help="A shipped recipe (see quadsim list recipes) or a TOML file.")
    ] = "hummingbird",
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Change of the recipe, as name=value. vehicle, imu: a shipped name or a TOML file. engine: "
            "auto or mujoco. rate: samples per second (default: 200). Other keys of a recipe are also "
            "accepted. Repeat the option to set more.",
        ),
    ] = None,
    seed: LearningSeed = 0,
    workers: Workers = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing dataset.")] = False,
) -> None:
    """Generate labelled synthetic flights: IMU readings with true motion, biases and wind.

    By default, the command generates 35 flights of 100 s at 200 Hz. This takes 5 to 15 seconds. The first run
    takes up to a minute longer, because it compiles code. If a run was stopped, the same command resumes it.
    The number of workers does not change the data.

    Example: quadsim generate --flights 4 --duration 20 --out data/small.zarr
    """
    from ..config.toml import parse
    from ..dataset.generation import generate as generate_dataset
    from ..dataset.reading import dataset_info
    from ..flight.recipe import changed_recipe
    from .conditions import Sampling

    changes = fields_of(set_)
    rate = parse({name: changes.pop(name) for name in ("rate",) if name in changes}, Sampling, "--set").rate
    config = changed_recipe(recipe, changes, "--set")
    with progress_bar("generate", "flights") as progress:
        path = generate_dataset(
            config,
            flights,
            duration,
            out,
            seed=seed,
            rate_hz=rate,
            workers=workers,
            progress=progress,
            overwrite=overwrite,
        )
    info = dataset_info(path)
    early = f" ({info['flights_ended_early']} ended early)" if info["flights_ended_early"] else ""
    say(
        f"{path}: {info['flights']} flights of {info['duration_s']:g} s at {info['rate_hz']:g} Hz{early}, "
        f"roll SD {info['roll_sd_deg']:.1f}°, pitch SD {info['pitch_sd_deg']:.1f}°, "
        f"largest tilt {info['max_tilt_deg']:.0f}°, {info['size_MB']:.1f} MB"
    )


def export(
    source: Annotated[
        list[str],
        typer.Argument(
            help="A dataset, weights (a file or a name from quadsim list weights), one or more logs, or a "
            "network from another tool (FILE.nir)."
        ),
    ],
    out: Annotated[Path, typer.Option(help="File or folder to write; it must not exist yet.")],
    format: Annotated[
        str | None,
        typer.Option(
            help="For a dataset: netcdf, parquet (one flat table) or huggingface (Parquet with a dataset "
            "card). For weights: c99 (spiking networks), nir (spiking networks of layers) or onnx (GRU "
            "networks). For logs: zarr (a dataset). For FILE.nir, omit this option."
        ),
    ] = None,
    piece: Annotated[
        float, typer.Option(min=1, help="For logs: length of each flight in the dataset, in seconds.")
    ] = 20.0,
    rate: Annotated[float, typer.Option(min=50, max=2000, help="For logs: samples per second.")] = 200.0,
    mount: Mount = None,
    truth: Truth = None,
    imu: Imu = None,
    force: Force = False,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="For FILE.nir, as name=value. dt: time step of the network, in seconds. input: a .npy file "
            "with an array of steps × inputs (default: random spikes). steps: number of steps of random "
            "spikes. Repeat the option to set more.",
        ),
    ] = None,
    seed: Seed = 0,
) -> None:
    """Convert a dataset or a network to another tool's format, or logs to a dataset.

    A network in NIR format (FILE.nir), for example from Norse or snnTorch, is rounded to the integers of the
    emulated Loihi chip. The command runs the rounded network and the original one on the same input. The
    output folder contains the integers, C99 files, and a report on agreement, cores and energy.

    Example: quadsim export att-snn --format c99 --out firmware

    Example: quadsim export data/train.zarr --format netcdf --out train.nc

    Example: quadsim export flight.ulg --format zarr --out data/mine.zarr

    Example: quadsim export mine.nir --set dt=1e-4 --out chip/mine
    """
    if source[0].endswith(".nir"):
        _import(source, out, format, set_, seed)
        return
    if format is None:
        raise ValueError(f"{source[0]}: give a --format; only FILE.nir needs none")
    if set_:
        raise ValueError("--set applies only to FILE.nir")
    from estimators.circuit.file import is_circuit
    from estimators.export.formats import FORMATS, export_weights
    from estimators.networks.weights_file import END, shipped_controllers, shipped_names

    from ..dataset.export import export as export_dataset

    if format == "zarr":
        from ..logs import read_parts, read_recording, refused
        from ..logs.convert import convert

        recordings = [read_recording(file, mount=mount, truth=truth, imu=imu) for file in source]
        logs = [part for each in recordings for part in read_parts(each, rate)]
        for fault in refused([log.attrs["log"] for log in logs], force):
            say(f"warning: {fault}", "yellow")
        convert(logs, out, piece)
        return
    if len(source) > 1:
        raise ValueError(f"--format {format} takes one dataset or network, not {len(source)}")
    shipped = is_circuit(source[0]) or source[0] in (*shipped_names(), *shipped_controllers())
    if shipped or source[0].endswith(END) or format in FORMATS:
        export_weights(source[0], out, format)
    else:
        with progress_bar("export", "flights") as progress:
            export_dataset(source[0], out, format, progress)
    say(f"{out}: {source[0]} exported as {format}")


FEW_SPIKES = 100
"""Number of spikes below which the measured agreement means little."""


def _import(source: list[str], out: Path, format: str | None, set_: list[str] | None, seed: int) -> None:
    from estimators.analysis.imported import ImportSettings, import_nir

    if len(source) > 1 or format is not None:
        raise ValueError(f"{source[0]}: give one NIR file and no --format")
    report = import_nir(source[0], out, settings_of(set_, ImportSettings), seed)
    print_table([map(_short, each.values()) for each in report["layers"]], [*report["layers"][0]])
    print_table((name, _short(each)) for name, each in report.items() if not isinstance(each, (dict, list)))
    same = "no neuron spikes on this input"
    if report["agreement"] is not None:
        few = "" if report["spikes"] >= FEW_SPIKES else ", too few spikes to measure the agreement"
        same = f"{100 * report['agreement']:.1f} % of {report['spikes']} spikes agree with floats{few}"
    say(f"{out}: {report['cores']} of a chip's 128 cores, {same}")


def _short(value: object) -> object:
    return f"{value:.4g}" if isinstance(value, float) else value
