"""Datasets in the formats of other tools: NetCDF, one flat table in Parquet, and a folder for Hugging Face.

NetCDF holds the whole dataset. The table contains only the samples before the end of a flight. Time starts at
the beginning of each flight. Quantities that were not recorded are NaN.
"""

import json
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import xarray as xr

from ..config.toml import nearest
from .reading import open_dataset
from .store import VARIABLES, Progress

CARD = """---
pretty_name: Flights simulated by quadsim
task_categories: [time-series-forecasting]
tags: [imu, attitude-estimation, quadrotor, neuromorphic]
configs:
  - config_name: default
    data_files: data/flights.parquet
---

# Flights simulated by quadsim

{n} flights of {duration_s:g} s at {rate_hz:g} Hz, a row for each sample, from quadsim {quadsim_version} with
seed {seed}. Name a licence here before you publish the folder.

| columns | unit | content |
|---|---|---|
| `flight` | 1 | number of the flight |
| `time` | s | time since the start of the flight |
{columns}

The recipe of the flights, as JSON:

```json
{config}
```
"""
"""Template of the card of a Hugging Face dataset."""


def export(
    path: str | Path, out: str | Path, format: str, progress: Progress = lambda done, total: None
) -> Path:
    """Write a dataset in another format.

    Args:
        path: A dataset.
        out: The file (netcdf, parquet) or folder (huggingface) to write. It must not exist.
        format: One of FORMATS: "netcdf", "parquet" or "huggingface" (a folder of Parquet with its card).
        progress: Called with the number of flights written and the total.

    Returns:
        The path written.

    Raises:
        ValueError: The format is unknown, `out` exists, or `path` is not a dataset.
        ModuleNotFoundError: A package of the extra "export" is missing.
        OSError: `out` cannot be written.
    """
    if format not in FORMATS:
        raise ValueError(f'unknown format "{format}"; {nearest(format, FORMATS)}')
    out = Path(out).expanduser()
    if out.exists():
        raise ValueError(f"{out} exists already: move it, or choose another --out")
    dataset = open_dataset(path)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as drafts:
            draft = Path(drafts) / out.name
            FORMATS[format](dataset, draft, progress)
            draft.rename(out)
    except OSError as error:
        raise OSError(f"cannot write {out}: {error.strerror or error}") from error
    return out


def _netcdf(dataset: xr.Dataset, out: Path, progress: Progress) -> None:
    encoding = {
        name: {"zlib": True, "complevel": 1, "shuffle": True, "chunksizes": (1, *dataset[name].shape[1:])}
        for name in VARIABLES
    }
    dataset.drop_encoding().to_netcdf(out, engine="h5netcdf", encoding=encoding)
    progress(dataset.sizes["flight"], dataset.sizes["flight"])


def _parquet(dataset: xr.Dataset, out: Path, progress: Progress) -> None:
    """Write one row per sample and one row group per flight; the metadata of each column has its unit."""
    import pyarrow as arrow
    from pyarrow import parquet

    fields = [
        arrow.field("flight", arrow.int32()),
        arrow.field("time", arrow.float64(), metadata={"units": "s"}),
    ]
    for name, variable in VARIABLES.items():
        labels = dataset[variable.dim].to_numpy()
        metadata = {"units": variable.units, "long_name": variable.long_name}
        fields += [arrow.field(f"{name}_{label}", arrow.float32(), metadata=metadata) for label in labels]
    attributes = {key: str(value) for key, value in dataset.attrs.items()}
    schema = arrow.schema(fields, metadata=attributes)
    with parquet.ParquetWriter(out, schema, compression="zstd") as writer:
        for flight, one in _flights(dataset, progress):
            steps = one.sizes["time"]
            columns = [np.full(steps, flight, "i4"), one["time"].to_numpy()]
            columns += [column for name in VARIABLES for column in one[name].to_numpy().T]
            writer.write_table(arrow.table([arrow.array(column) for column in columns], schema=schema))


def _huggingface(dataset: xr.Dataset, out: Path, progress: Progress) -> None:
    """Write the folder of a Hugging Face dataset: the card README.md and one Parquet table of samples."""
    (out / "data").mkdir(parents=True)
    _parquet(dataset, out / "data" / "flights.parquet", progress)
    rows = []
    for name, each in VARIABLES.items():
        labels = ", ".join(f"`{name}_{label}`" for label in dataset[each.dim].to_numpy())
        rows.append(f"| {labels} | {each.units} | {each.long_name} |")
    (out / "README.md").write_text(
        CARD.format(columns="\n".join(rows), **dataset.attrs, n=dataset.sizes["flight"])
    )


def _flights(dataset: xr.Dataset, progress: Progress) -> Iterator[tuple[int, xr.Dataset]]:
    """Yield the samples of each flight before its end.

    Report progress when the caller asks for the next flight.
    """
    unknown = json.loads(dataset.attrs["config"]).get("unknown", ())
    total = dataset.sizes["flight"]
    for flight in range(total):
        one = dataset.isel(flight=flight)
        one = one.isel(time=slice(int(one["valid_steps"]))).load()
        yield flight, one.assign({name: xr.full_like(one[name], np.nan) for name in unknown})
        progress(flight + 1, total)


FORMATS: dict[str, Callable[[xr.Dataset, Path, Progress], None]] = {
    "netcdf": _netcdf,
    "parquet": _parquet,
    "huggingface": _huggingface,
}
