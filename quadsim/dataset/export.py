"""Datasets in the formats of other tools: NetCDF, Parquet, Hugging Face, EuRoC (ASL) folders, and ROS 2 bags.

Only samples before the end of a flight are exported, except to NetCDF, which holds the whole dataset. Time
starts at the beginning of each flight. Quantities that were not recorded are NaN.
"""

import json
import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ..config.toml import nearest, parse
from ..imu.spec import ImuSpec
from ..rotation import matrix_from_quat, quat_from_euler
from .reading import open_dataset
from .store import VARIABLES, Progress

Array = NDArray[np.float64]

IMU_HEADER = "#timestamp [ns]," + ",".join(
    f"{kind}_RS_S_{axis} [{unit}]" for kind, unit in (("w", "rad s^-1"), ("a", "m s^-2")) for axis in "xyz"
)
TRUTH_HEADER = "#timestamp," + ",".join(
    f" {kind}_{label} [{unit}]"
    for kind, labels, unit in (
        ("p_RS_R", "xyz", "m"),
        ("q_RS", "wxyz", ""),
        ("v_RS_R", "xyz", "m s^-1"),
        ("b_w_RS_S", "xyz", "rad s^-1"),
        ("b_a_RS_S", "xyz", "m s^-2"),
    )
    for label in labels
)
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
TRUTH = ("position", "quat", "velocity", "gyro_bias", "accel_bias")


def export(
    path: str | Path, out: str | Path, format: str, progress: Progress = lambda done, total: None
) -> Path:
    """Write a dataset in another format.

    Args:
        path: A dataset.
        out: The file (netcdf, parquet) or folder (huggingface, csv, rosbag2) to write. It must not exist.
        format: One of FORMATS: "netcdf", "parquet", "huggingface" (a folder of Parquet with its card), "csv"
            (EuRoC layout) or "rosbag2".
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
    except (OSError, sqlite3.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise OSError(f"cannot write {out}: {reason or error}") from error
    return out


def timestamps(steps: int, rate_hz: float) -> NDArray[np.int64]:
    """Return the time of each sample since the start of its flight, (steps,) [ns]."""
    return np.rint(np.arange(steps) * (1e9 / rate_hz)).astype(np.int64)


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


def _euroc(dataset: xr.Dataset, out: Path, progress: Progress) -> None:
    """Write a folder per flight in the layout of the EuRoC MAV dataset.

    The body frame is at the centre of mass.
    """
    rate_hz = dataset.attrs["rate_hz"]
    truth = _yaml("visual-inertial", "the simulated state itself", np.eye(4))
    sensors = {
        "imu0": (_imu_yaml(_imu_of(dataset), rate_hz), IMU_HEADER, ("gyro", "accel")),
        "state_groundtruth_estimate0": (truth, TRUTH_HEADER, TRUTH),
    }
    for flight, one in _flights(dataset, progress):
        time = timestamps(one.sizes["time"], rate_hz)  # float64 holds nanoseconds exactly for 104 days
        mav = out / f"flight_{flight:03d}" / "mav0"
        for name, (yaml, header, variables) in sensors.items():
            (mav / name).mkdir(parents=True)
            (mav / name / "sensor.yaml").write_text(yaml, encoding="utf-8")
            table = np.column_stack([time, *(one[variable] for variable in variables)])
            formats = ["%d", *["%.9g"] * (table.shape[1] - 1)]
            np.savetxt(mav / name / "data.csv", table, formats, delimiter=",", header=header, comments="")
        (mav / "body.yaml").write_text("%YAML:1.0\ncomment: simulated quadrotor\n", encoding="utf-8")


def _yaml(sensor_type: str, comment: str, sensor_to_body: Array) -> str:
    numbers = ", ".join(f"{value:.9g}" for value in sensor_to_body.ravel())
    return (
        f"%YAML:1.0\nsensor_type: {sensor_type}\ncomment: {comment}\n"
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{numbers}]\n"
    )


def _imu_yaml(imu: ImuSpec | None, rate_hz: float) -> str:
    sensor_to_body = np.eye(4)
    if imu is None:
        return _yaml("imu", "IMU of unknown noise", sensor_to_body) + f"rate_hz: {rate_hz:g}\n"
    sensor_to_body[:3, :3] = matrix_from_quat(quat_from_euler(*np.radians(imu.mounting_deg)))
    sensor_to_body[:3, 3] = imu.lever_arm
    return _yaml("imu", "simulated IMU", sensor_to_body) + (
        f"rate_hz: {rate_hz:g}\n"
        f"gyroscope_noise_density: {imu.gyro.noise:.9g}  # [ rad / s / sqrt(Hz) ]\n"
        f"gyroscope_random_walk: {imu.gyro.random_walk:.9g}  # [ rad / s^2 / sqrt(Hz) ]\n"
        f"accelerometer_noise_density: {imu.accel.noise:.9g}  # [ m / s^2 / sqrt(Hz) ]\n"
        f"accelerometer_random_walk: {imu.accel.random_walk:.9g}  # [ m / s^3 / sqrt(Hz) ]\n"
    )


def _rosbag2(dataset: xr.Dataset, out: Path, progress: Progress) -> None:
    """Write a bag per flight: `/imu` (sensor_msgs/Imu, frame `imu`) and the true `/pose` (frame `world`)."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    message = store.types
    vector, point = message["geometry_msgs/msg/Vector3"], message["geometry_msgs/msg/Point"]
    quaternion, pose = message["geometry_msgs/msg/Quaternion"], message["geometry_msgs/msg/Pose"]
    rate_hz, imu = dataset.attrs["rate_hz"], _imu_of(dataset)
    level, absent = quaternion(0.0, 0.0, 0.0, 1.0), np.array([-1.0, *[0.0] * 8])  # holds no orientation
    gyro_noise, accel_noise = (  # zeros where it is unknown, by convention
        np.diag([sensor.noise**2 * rate_hz] * 3).ravel() if sensor else np.zeros(9)
        for sensor in (imu and imu.gyro, imu and imu.accel)
    )

    def add(bag: Any, connection: Any, time: int, frame: str, *fields: Any) -> None:
        stamp = message["builtin_interfaces/msg/Time"](*divmod(time, 1_000_000_000))
        made = message[connection.msgtype](message["std_msgs/msg/Header"](stamp, frame), *fields)
        bag.write(connection, time, store.serialize_cdr(made, connection.msgtype))

    for flight, one in _flights(dataset, progress):
        gyro, accel, position, quat = (
            one[name].to_numpy().astype(float).tolist() for name in ("gyro", "accel", "position", "quat")
        )
        with Writer(out / f"flight_{flight:03d}", version=9) as bag:
            imus = bag.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
            poses = bag.add_connection("/pose", "geometry_msgs/msg/PoseStamped", typestore=store)
            for k, time in enumerate(timestamps(one.sizes["time"], rate_hz).tolist()):
                w, x, y, z = quat[k]
                read = (vector(*gyro[k]), gyro_noise, vector(*accel[k]), accel_noise)
                add(bag, imus, time, "imu", level, absent, *read)
                add(bag, poses, time, "world", pose(point(*position[k]), quaternion(x, y, z, w)))


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


def _imu_of(dataset: xr.Dataset) -> ImuSpec | None:
    """Return the simulated IMU; None if the flights were recorded or the dataset does not name the IMU."""
    config = json.loads(dataset.attrs["config"])
    if "imu" not in config or "logs" in config:
        return None
    return parse(config["imu"], ImuSpec, "the IMU of this dataset")


FORMATS: dict[str, Callable[[xr.Dataset, Path, Progress], None]] = {
    "netcdf": _netcdf,
    "csv": _euroc,
    "parquet": _parquet,
    "huggingface": _huggingface,
    "rosbag2": _rosbag2,
}
