"""The command `report`: show benchmarks, datasets, weights and logs."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..runs.console import output, print_table, progress_bar, say
from .options import Imu, Mount, Truth


def report(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="PATH",
            help="A folder written by bench, a dataset (.zarr), weights (a file or a name), or a log. "
            "Several folders written by bench --task are also accepted.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="For a benchmark: HTML file to write (default: PATH/report.html). For a dataset: PNG file "
            "to write."
        ),
    ] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="For a dataset: compare every file with its checksum.")
    ] = False,
    data: Annotated[
        list[Path] | None,
        typer.Option(help="For weights: dataset on which to run the network. Repeat the option to add more."),
    ] = None,
    mount: Mount = None,
    truth: Truth = None,
    imu: Imu = None,
    find_mount: Annotated[
        Literal["best", "level"] | None,
        typer.Option(
            help="For a log: estimate the value for --mount. best: use the true attitude if the log has one, "
            "and the mean force in hover otherwise. level: always use the mean force in hover."
        ),
    ] = None,
) -> None:
    """Show a benchmark, a dataset, weights or a log, depending on PATH.

    For a benchmark, the command writes the HTML report again. For folders written by bench --task, the
    command writes one leaderboard of all entries.

    For a dataset, the command prints a summary. With --out, the command also draws one flight and the
    distributions of readings and attitudes. Files whose size or time stamp has changed are compared with
    their checksums; with --verify, all files are compared.

    For weights of a spiking network, the command prints the number of cores that the network needs on a
    Loihi chip. With --data, the command also prints spikes, operations, modelled energy and error on the
    flights of that dataset.

    For a log, the command prints a summary, any problems in the log, and the source of the true attitude.

    Example: quadsim report reports/bench

    Example: quadsim report data/train.zarr --out train.png

    Example: quadsim report att-snn --data data/val.zarr

    Example: quadsim report flight.ulg --find-mount best
    """
    from estimators.circuit.file import is_circuit
    from estimators.networks.weights_file import END, shipped_controllers, shipped_names
    from scenarios.verbs import has_entries, report_benchmark, report_entries

    path, place = paths[0], Path(paths[0]).expanduser()
    given = {"--out": out, "--verify": verify, "--data": data}
    given |= {"--mount": mount, "--truth": truth, "--imu": imu, "--find-mount": find_mount}
    if has_entries(place):
        _refuse_others(given, "a task", "--out")
        report_entries([Path(each) for each in paths], out or place / "leaderboard.html")
    elif len(paths) > 1:
        raise ValueError(f"{path}: contains no entry of a task; for anything else, give one PATH only")
    elif is_circuit(path):
        _refuse_others(given, "a circuit", "--data")
        _report_circuit(path, data or [])
    elif place.suffix == END or path in (*shipped_names(), *shipped_controllers()):
        _refuse_others(given, "weights", "--data")
        _report_weights(path, data or [])
    elif place.suffix == ".zarr" or (place / "zarr.json").exists():
        _refuse_others(given, "a dataset", "--out", "--verify")
        _report_dataset(place, verify, out)
    elif (place / "bench.json").exists():
        _refuse_others(given, "a benchmark", "--out")
        report_benchmark(place, out)
    elif place.is_dir() and (out is not None or not any(place.iterdir())):
        raise ValueError(f"{path}: contains no finished entry of a task, no benchmark and no dataset")
    elif place.exists():
        _refuse_others(given, "a log", "--mount", "--truth", "--imu", "--find-mount")
        _report_log(place, mount, truth, imu, find_mount)
    else:
        raise ValueError(f"{path}: no such benchmark, dataset, weights or log")


def _refuse_others(given: dict[str, object], what: str, *allowed: str) -> None:
    for name, value in given.items():
        if value and name not in allowed:
            raise ValueError(f"{name} does not apply to {what}; it accepts only {', '.join(allowed)}")


def _report_log(
    path: Path, mount: str | None, truth: str | None, imu: str | None, find_mount: str | None
) -> None:
    from ..logs import read_log
    from ..logs.log_report import show_report
    from ..logs.mounting import estimate_mount, show_estimate

    log = read_log(path, mount=mount, truth=truth, imu=imu)
    if find_mount is None:
        show_report(path, log.attrs["log"])
    else:
        show_estimate(path, estimate_mount(log, mount, find_mount == "level"))


def _report_dataset(path: Path, verify: bool, out: Path | None) -> None:
    from ..dataset.figures import plot
    from ..dataset.reading import dataset_info
    from ..dataset.reading import verify as verify_dataset

    if verify:
        with progress_bar("verify", "flights") as progress:
            total = verify_dataset(path, progress)
        say(f"{path}: all {total} flights match their checksums")
    info = dataset_info(path).items()
    print_table([(k, f"{v:.3f}" if isinstance(v, float) else v) for k, v in info if k != "config"])
    if out is not None:
        say(f"{plot(path, out)}")


def _report_circuit(path: str, data: list[Path]) -> None:
    from estimators.analysis.circuit import measure_datasets
    from estimators.circuit.file import load_circuit
    from estimators.circuit.on_chip import place, populations
    from estimators.circuit.parameters import quantised

    config, parameters = load_circuit(path)
    circuit = quantised(parameters, config.steps_per_sample)
    parts = populations(circuit)
    rows = [(each.name, each.neurons, each.compartments, each.synapses) for each in parts]
    print_table(rows, ["population", "neurons", "compartments", "synapses"])
    neurons, cores = sum(each.neurons for each in parts), place(circuit)
    last = f"{path}: {neurons} neurons on {cores} of a chip's 128 cores"
    if data:
        found = measure_datasets(config, parameters, data)
        print_table(found.summary())
        last += f", error {found.error_deg:.2f}°"
    say(last)


def _report_weights(weights: str, data: list[Path]) -> None:
    from estimators.analysis.energy import chip_summary
    from estimators.evaluation.flights import load_flights
    from estimators.networks.forward import OnLoihi
    from estimators.networks.weights_file import load_network
    from scenarios.report.terminal import cores_table

    from ..dataset.reading import open_dataset

    config, tensors = load_network(weights)
    core = OnLoihi(config, tensors)
    output.print(cores_table(core.cores))
    last = f"{weights}: {sum(core.sizes)} neurons on {len(core.cores)} of a chip's 128 cores"
    if data:
        found = chip_summary(config, core, load_flights([open_dataset(path) for path in data]))
        print_table(found.items())
        last += f", error {found['error']}"
    say(last)
