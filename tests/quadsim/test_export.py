import json
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray as xr

from quadsim.dataset import store as dataset_store
from quadsim.dataset.export import FORMATS, export, timestamps
from quadsim.dataset.figures import plot
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.dataset.store import VARIABLES, Recorded
from quadsim.flight.recipe import Recipe
from quadsim.flight.simulate import simulate_flights
from quadsim.imu.spec import load_imu
from quadsim.vehicle import load_vehicle

FLIGHTS, STEPS, ENDS = 3, 60, [60, 25, 60]
IMU = load_imu("adis16448").model_copy(
    update={"lever_arm": (0.01, 0.02, 0.03), "mounting_deg": (0.0, 0.0, 90.0)}
)
CONFIG = Recipe(vehicle=load_vehicle("hummingbird"), imu=IMU, warmup_s=0.0)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def ending_early(config, seeds, steps, rate_hz):
        log = simulate_flights(config, seeds, steps, rate_hz)
        log["end_step"][1], log["end_reason"][1] = ENDS[1], "hit the ground"
        return log

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dataset_store, "simulate_flights", ending_early)
        return generate(CONFIG, FLIGHTS, STEPS / 200, tmp_path_factory.mktemp("data") / "x.zarr", workers=1)


def flown(source: Path, flight: int) -> xr.Dataset:
    return open_dataset(source).isel(flight=flight, time=slice(ENDS[flight]))


def test_netcdf_holds_the_whole_dataset(source, tmp_path):
    out = export(source, tmp_path / "x.nc", "netcdf")
    with xr.open_dataset(out, engine="h5netcdf") as found:
        xr.testing.assert_identical(found.load(), open_dataset(source).load())


@pytest.mark.parametrize("format", ["csv", "parquet", "rosbag2"])
@pytest.mark.parametrize("kind", ["without an IMU", "recorded"])
def test_a_dataset_whose_imu_is_unknown_is_exported_without_its_noise(source, tmp_path, format, kind):
    dataset, out, unknown = open_dataset(source), tmp_path / "out", ()
    config = json.loads(dataset.attrs["config"])
    del config["imu"]
    if kind == "recorded":
        unknown = ("position", "gyro_bias")
        config = Recorded(logs=("a",), piece_s=1.0, unknown=unknown)._asdict()
    FORMATS[format](dataset.assign_attrs(config=json.dumps(config)), out, lambda *done: None)
    if format == "csv":
        mav = out / "flight_000" / "mav0"
        assert "noise_density" not in (mav / "imu0" / "sensor.yaml").read_text()
        truth = np.loadtxt(mav / "state_groundtruth_estimate0" / "data.csv", delimiter=",")
        lacking = np.flatnonzero(np.isnan(truth).any(axis=0)).tolist()
        assert lacking == ([1, 2, 3, 11, 12, 13] if unknown else [])
    elif format == "parquet":
        parquet = pytest.importorskip("pyarrow.parquet")
        table = parquet.ParquetFile(out).read_row_group(0)
        assert np.isnan(table["position_x"]).all() == bool(unknown)
        assert np.isfinite(table["gyro_x"]).all()


def test_a_hugging_face_folder_has_a_card_and_the_table(source, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    folder = export(source, tmp_path / "hub", "huggingface")
    card = (folder / "README.md").read_text()
    file = card.split("data_files: ")[1].split()[0]
    table = parquet.ParquetFile(folder / file)
    assert table.metadata.num_rows == sum(ENDS)
    assert card.startswith("---\npretty_name:")
    for name in table.schema_arrow.names:
        assert f"`{name}`" in card
    assert json.loads(card.split("```json")[1].split("```")[0])["vehicle"]["name"] == "hummingbird"


def test_parquet_holds_every_sample_flown_as_a_row_with_units(source, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    file = parquet.ParquetFile(export(source, tmp_path / "x.parquet", "parquet"))
    assert file.num_row_groups == FLIGHTS
    assert file.schema_arrow.field("accel_z").metadata[b"units"] == b"m/s^2"
    assert json.loads(file.schema_arrow.metadata[b"config"]) == CONFIG.model_dump(mode="json")
    for flight in range(FLIGHTS):
        table, truth = file.read_row_group(flight), flown(source, flight)
        assert set(table["flight"].to_pylist()) == {flight}
        assert np.array_equal(table["time"], truth["time"])
        for name, variable in VARIABLES.items():
            columns = [table[f"{name}_{label}"] for label in truth[variable.dim].to_numpy()]
            assert np.array_equal(np.stack(columns, axis=-1), truth[name])


@pytest.fixture(scope="module")
def euroc(source, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(source, tmp_path_factory.mktemp("euroc") / "x", "csv")


def test_euroc_files_hold_the_samples_flown_in_nanoseconds(source, euroc):
    for flight in range(FLIGHTS):
        mav, truth = euroc / f"flight_{flight:03d}" / "mav0", flown(source, flight)
        imu = np.loadtxt(mav / "imu0" / "data.csv", delimiter=",")
        state = np.loadtxt(mav / "state_groundtruth_estimate0" / "data.csv", delimiter=",")
        assert np.array_equal(imu[:, 0], np.arange(ENDS[flight]) * 5_000_000)
        assert np.array_equal(imu[:, 0], state[:, 0])
        names = ("gyro", "accel", "position", "quat", "velocity", "gyro_bias", "accel_bias")
        values = np.concatenate([imu[:, 1:], state[:, 1:]], axis=1).astype("f4")
        assert np.array_equal(values, np.concatenate([truth[name] for name in names], axis=1))


def test_euroc_headers_and_sensor_are_those_of_the_original_dataset(euroc):
    imu, truth = (euroc / "flight_000" / "mav0" / name for name in ("imu0", "state_groundtruth_estimate0"))
    assert (imu / "data.csv").read_text().splitlines()[0] == (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
    )
    assert (truth / "data.csv").read_text().splitlines()[0] == (
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
        "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], "
        "b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], "
        "b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]"
    )
    yaml = pytest.importorskip("yaml")
    sensor = yaml.safe_load((imu / "sensor.yaml").read_text().split("\n", 1)[1])
    pose = np.reshape(sensor["T_BS"]["data"], (4, 4))
    assert pose[:3, 3] == pytest.approx(IMU.lever_arm)
    assert pose[:3, :3] @ [1, 0, 0] == pytest.approx([0, 1, 0])  # its x axis is the body's y axis
    assert sensor["gyroscope_noise_density"] == pytest.approx(IMU.gyro.noise)
    assert sensor["accelerometer_random_walk"] == pytest.approx(IMU.accel.random_walk)
    assert sensor["rate_hz"] == 200


def test_rosbags_hold_imu_and_pose_of_every_sample_flown(source, tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    out = export(source, tmp_path / "bags", "rosbag2")
    for flight in range(FLIGHTS):
        truth, found = flown(source, flight), {"/imu": [], "/pose": []}
        with rosbag2.Reader(out / f"flight_{flight:03d}") as bag:
            for topic, time, raw in bag.messages():
                message = store.deserialize_cdr(raw, topic.msgtype)
                stamp = message.header.stamp
                assert stamp.sec * 1_000_000_000 + stamp.nanosec == time
                found[topic.topic].append((time, message))
        for messages in found.values():
            assert [time for time, _ in messages] == timestamps(ENDS[flight], 200.0).tolist()
        imu, pose = ([message for _, message in found[topic]] for topic in ("/imu", "/pose"))
        assert imu[0].orientation_covariance[0] == -1
        assert imu[0].angular_velocity_covariance[4] == pytest.approx(IMU.gyro.noise**2 * 200)
        assert np.array_equal([xyz(each.angular_velocity) for each in imu], truth["gyro"])
        assert np.array_equal([xyz(each.linear_acceleration) for each in imu], truth["accel"])
        assert np.array_equal([xyz(each.pose.position) for each in pose], truth["position"])
        quat = [(each.pose.orientation.w, *xyz(each.pose.orientation)) for each in pose]
        assert np.array_equal(quat, truth["quat"])


def xyz(message) -> tuple[float, float, float]:
    return message.x, message.y, message.z


def test_timestamps_do_not_drift_at_rates_that_divide_unevenly():
    assert timestamps(3_000_001, 300.0)[-1] == 10_000 * 1_000_000_000
    assert np.ptp(np.diff(timestamps(1000, 300.0))) <= 1


@pytest.mark.parametrize("format", FORMATS)
def test_progress_ends_with_the_last_flight(source, tmp_path, format):
    calls = []
    export(source, tmp_path / "out", format, progress=lambda *done: calls.append(done))
    assert calls[-1] == (FLIGHTS, FLIGHTS)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize(
    ("out", "format", "error", "text"),
    [
        ("x", "netcfd", ValueError, r'unknown format "netcfd"; did you mean "netcdf"\? valid: netcdf, csv'),
        ("thesis", "csv", ValueError, "exists already"),
        ("thesis/x.nc", "netcdf", OSError, r"cannot write .*/thesis/x.nc: "),
    ],
)
def test_a_format_or_a_place_that_is_none_is_one_clear_line(source, tmp_path, out, format, error, text):
    (tmp_path / "thesis").write_text("chapter 1")
    with pytest.raises(error, match=text):
        export(source, tmp_path / out, format)
    assert (tmp_path / "thesis").read_text() == "chapter 1"


def test_a_picture_has_ink_in_every_part(source, tmp_path):
    picture = imageio.imread(plot(source, tmp_path / "new" / "x.png"))[..., :3]
    assert picture.shape[0] > 1000
    assert picture.shape[1] > 1000
    parts = [part for row in np.array_split(picture, 5) for part in np.array_split(row, 4, axis=1)]
    assert all(np.ptp(part) > 100 for part in parts)
