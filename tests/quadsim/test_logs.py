"""Logs of other tools: every format gives the same flight back, in our frames, with what is odd counted."""

from dataclasses import replace

import numpy as np
import pytest
from reported import reported
from sensor import GRAVITY, RATE, blind, readings, report_of, turned, turning, write_csv
from typer.testing import CliRunner
from ulog_file import write_ulog

from quadsim.cli import app
from quadsim.dataset.export import export
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import Recipe
from quadsim.imu.spec import ImuSpec, load_imu
from quadsim.imu.stream import simulate_imu
from quadsim.logs import read_log, read_recording
from quadsim.logs.allan import allan_variance, calibrate, model_variance, write_imu
from quadsim.logs.cleaning import split
from quadsim.logs.convert import convert
from quadsim.logs.recording import Recording, Track, mount_matrix, mounted
from quadsim.logs.resample import resample
from quadsim.rotation import (
    quat_from_euler,
    quat_from_rotvec,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    roll_pitch_from_quat,
    swap_enu_flu_ned_frd,
    swap_flu_frd,
)
from quadsim.vehicle import load_vehicle


def consistent(log) -> None:
    """The gyro turns the attitude, and the attitude turns the specific force upright: all frames are ours."""
    gyro, accel, quat = (log[name].to_numpy()[0] for name in ("gyro", "accel", "quat"))
    np.testing.assert_allclose(quat_rotate(quat, accel), np.broadcast_to(GRAVITY, accel.shape), atol=2e-3)
    up = quat_rotate_inverse(quat, GRAVITY / 9.81)
    turn = np.gradient(up, 1 / log.attrs["rate_hz"], axis=0)
    np.testing.assert_allclose(turn[2:-2], np.cross(up, gyro)[2:-2], atol=5e-3)


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A flight of three seconds with a clean IMU, as a dataset."""
    config = Recipe(vehicle=load_vehicle("hummingbird"), imu=load_imu("perfect"), warmup_s=0.0)
    return generate(config, 1, 3.0, tmp_path_factory.mktemp("logs") / "x.zarr", seed=5, workers=1)


@pytest.mark.parametrize("format", ["csv", "rosbag2"])
def test_an_exported_flight_is_read_back(flight, tmp_path, format):
    if format == "rosbag2":
        pytest.importorskip("rosbags")
    log, report = reported(export(flight, tmp_path / "out", format) / "flight_000")
    found, wanted = log.isel(flight=0), open_dataset(flight).isel(flight=0)
    assert (found.sizes["time"], report.gaps, report.truth_share) == (600, 0, 1.0)
    for name in ("gyro", "accel", "position"):
        np.testing.assert_allclose(found[name], wanted[name], atol=1e-5)
    same = np.abs(np.sum(found["quat"].to_numpy() * wanted["quat"].to_numpy(), axis=-1))
    np.testing.assert_allclose(same, 1.0, atol=1e-9)


def test_the_mounting_in_an_exported_folder_is_undone(tmp_path):
    imu = load_imu("perfect").model_copy(update={"mounting_deg": (0.0, 0.0, 90.0)})
    config = Recipe(vehicle=load_vehicle("hummingbird"), imu=imu, warmup_s=0.0)
    data = generate(config, 1, 1.0, tmp_path / "x.zarr", seed=5, workers=1)
    log = read_log(export(data, tmp_path / "out", "csv"))
    np.testing.assert_allclose(log["gyro"][0], open_dataset(data)["ang_vel"][0], atol=1e-5)


def write_bag(path, ros: int) -> None:
    """A bag of ROS 1 (.bag), or a folder of ROS 2 with an .mcap: the turning sensor, and poses of it."""
    pytest.importorskip("rosbags")
    from rosbags import rosbag1, rosbag2, typesys

    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if ros == 1 else typesys.Stores.ROS2_HUMBLE)
    write = store.serialize_ros1 if ros == 1 else store.serialize_cdr
    mcap = {"version": 9, "storage_plugin": rosbag2.StoragePlugin.MCAP}
    kinds, none = store.types, np.zeros(9)
    vector, turn = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Quaternion"]
    header, stamped = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    time, gyro, accel, quat = turning()
    with rosbag1.Writer(path) if ros == 1 else rosbag2.Writer(path, **mcap) as bag:
        imu = bag.add_connection("/imu0", "sensor_msgs/msg/Imu", typestore=store)
        pose = bag.add_connection("/vicon", "geometry_msgs/msg/TransformStamped", typestore=store)
        for k, stamp in enumerate(np.rint((time + 100.0) * 1e9).astype(int).tolist()):
            head = header(*([k] if ros == 1 else []), stamped(*divmod(stamp, 10**9)), "imu")
            w, x, y, z = map(float, quat[k])
            unknown, read = turn(0.0, 0.0, 0.0, 0.0), (vector(*gyro[k]), none, vector(*accel[k]), none)
            message = kinds["sensor_msgs/msg/Imu"](head, unknown, none, *read)
            bag.write(imu, stamp, write(message, "sensor_msgs/msg/Imu"))
            move = kinds["geometry_msgs/msg/Transform"](vector(0.0, 0.0, 0.0), turn(x, y, z, w))
            message = kinds["geometry_msgs/msg/TransformStamped"](head, "body", move)
            bag.write(pose, stamp, write(message, "geometry_msgs/msg/TransformStamped"))


def test_ros_bags_and_an_mcap_file_without_its_folder_are_read(tmp_path):
    write_bag(tmp_path / "x.bag", 1)
    write_bag(tmp_path / "bag", 2)
    alone = next((tmp_path / "bag").glob("*.mcap")).rename(tmp_path / "alone.mcap")
    for path in (tmp_path / "x.bag", alone):
        log, report = reported(path)
        consistent(log)
        assert report.truth == "/vicon: poses"
        with pytest.raises(ValueError, match=r'no topic "/imu1" of the right kind; topics: /imu0'):
            read_log(path, imu="/imu1")


def write_px4(path, **topics):
    """A PX4 log of the turning sensor and of further topics: fields, stamps [s] and values."""
    pytest.importorskip("pyulog")
    time, gyro, accel, _ = turning()
    imu = np.concatenate([swap_flu_frd(gyro), swap_flu_frd(accel)], axis=1)
    topics["sensor_combined"] = ("float[3] gyro_rad;float[3] accelerometer_m_s2;", time, imu)
    return write_ulog(
        path,
        {
            name: (f"uint64_t timestamp;{fields}", (stamps * 1e6).astype(np.uint64) + 1_000_000, values)
            for name, (fields, stamps, values) in topics.items()
        },
    )


def test_px4_logs_are_turned_from_frd_and_ned(tmp_path):
    time, _, _, quat = turning()
    level = swap_enu_flu_ned_frd(quat_from_euler(0.0, 0.0, 0.0) + np.zeros((time.size, 4)))
    own, mocap = (("float[4] q;", time, each) for each in (level, swap_enu_flu_ned_frd(quat)))
    write_px4(tmp_path / "x.ulg", vehicle_attitude=own, vehicle_mocap_odometry=mocap)
    log, report = reported(tmp_path / "x.ulg")
    consistent(log)
    np.testing.assert_allclose(roll_pitch_from_quat(log["quat"][0]), roll_pitch_from_quat(quat), atol=1e-5)
    assert report.truth == "vehicle_mocap_odometry: motion capture"
    own, report = reported(tmp_path / "x.ulg", truth="vehicle_attitude")
    assert np.abs(roll_pitch_from_quat(own["quat"][0])).max() < 1e-6
    assert "no independent truth" in report.truth
    assert "the truth hardly turns where the gyroscope does" in report.warnings
    assert any("frames disagree" in warning for warning in report.warnings)


def test_px4_rotor_speeds_and_magnetometer_are_read_where_they_are_logged(tmp_path):
    time = turning()[0]
    field = np.array([2e-5, -1e-5, -4e-5])  # T, in FLU axes
    rpm = np.tile([2.0, 4000.0, -4100.0], (time[::20].size, 1))  # how many ESCs there are, and their speeds
    gauss = np.tile(swap_flu_frd(field) * 1e4, (time[::4].size, 1))
    escs = "float esc_count;float esc[0].esc_rpm;float esc[1].esc_rpm;"
    sensor_mag = ("float x;float y;float z;", time[::4], gauss)
    write_px4(tmp_path / "x.ulg", esc_status=(escs, time[::20], rpm), sensor_mag=sensor_mag)
    log = read_log(tmp_path / "x.ulg")
    speeds = np.array([4000.0, 4100.0]) * np.pi / 30
    for name, wanted, least in (("rotor_vel", speeds, 0.9), ("mag", field, 0.0)):
        found = log[name][0].to_numpy()
        known = np.isfinite(found).all(axis=1)
        assert known.mean() > least
        np.testing.assert_allclose(found[known], np.tile(wanted, (known.sum(), 1)), rtol=1e-6, atol=1e-9)


def test_sensors_beside_the_imu_are_interpolated_but_not_over_gaps():
    time = np.arange(800) / RATE
    slow = time[::10][(time[::10] < 1.0) | (time[::10] > 2.0)]
    speeds = Track(slow, np.stack([100.0 + slow, 200.0 - slow], axis=1))
    still = np.tile(GRAVITY, (800, 1))
    log = resample(Recording("x", "x", time, 0 * still, still, sensors={"rotor_vel": speeds}), RATE)[0]
    given = log["rotor_vel"][0].to_numpy()
    assert np.isnan(given[(time > 1.0) & (time < 1.99)]).all()
    np.testing.assert_allclose(given[:180, 0], 100.0 + time[:180])


def test_broad_trials_in_hdf5_and_mat_are_one_and_the_same(tmp_path):
    h5py, io = pytest.importorskip("h5py"), pytest.importorskip("scipy.io")
    time, gyro, accel, quat = turning(rate_hz=2000 / 7)
    moving = (time > 1) & (time < 2)
    trial = {"imu_gyr": gyro, "imu_acc": accel, "opt_quat": quat, "movement": moving}
    with h5py.File(tmp_path / "x.hdf5", "w") as file:
        for name, values in trial.items():
            file[name] = values
    io.savemat(tmp_path / "x.mat", trial)
    from_hdf5, from_mat = read_log(tmp_path / "x.hdf5"), read_log(tmp_path / "x.mat")
    consistent(from_hdf5.isel(time=slice(20, -20)))
    np.testing.assert_array_equal(from_hdf5["gyro"], from_mat["gyro"])
    scored = from_hdf5["time"].to_numpy()[from_hdf5["scored"].to_numpy()[0]]
    assert (scored.min(), scored.max()) == pytest.approx((1.0, 2.0), abs=0.01)


COLUMNS = """
file = "x.csv"
frame = "frd"
mount = "z,y,-x"
[time]
column = "t"
unit = "us"
[gyro]
columns = ["wx", "wy", "wz"]
unit = "deg/s"
[accel]
columns = ["ax", "ay", "az"]
unit = "g"
negate = true
[quat]
columns = ["qx", "qy", "qz", "qw"]
order = "xyzw"
direction = "world_to_body"
[mag]
columns = ["mx", "my", "mz"]
unit = "uT"
[rotor_vel]
columns = ["rpm"]
unit = "rpm"
"""


def test_a_csv_is_read_by_its_column_map(tmp_path):
    time, gyro, accel, quat = turning()
    frame_to_imu = mount_matrix("z,y,-x").T
    gyro, accel = (swap_flu_frd(each) @ frame_to_imu.T for each in (gyro, accel))
    q = swap_enu_flu_ned_frd(quat) * (1, -1, -1, -1)
    rows = np.column_stack(
        [time * 1e6, np.degrees(gyro), -accel / 9.80665, np.roll(q, -1, axis=1), -accel, 60 + 0 * time]
    )
    header = "t,wx,wy,wz,ax,ay,az,qx,qy,qz,qw,mx,my,mz,rpm"
    np.savetxt(tmp_path / "x.csv", rows, "%.9g", delimiter=",", header=header, comments="")
    (tmp_path / "x.toml").write_text(COLUMNS)
    log = read_log(tmp_path / "x.toml")
    consistent(log)
    np.testing.assert_allclose(log["mag"], -1e-6 * log["accel"], atol=1e-7)
    np.testing.assert_allclose(log["rotor_vel"], 2 * np.pi, rtol=1e-6)
    for old, new, fault in (
        ('"wz"', '"gz"', r'no column "gz"; '),
        ('"wz"', '"wy"', r"gyro\.columns: wx, wy, wy; one is there twice"),
        ("unit =", "units =", r'unknown key "time\.units"'),
    ):
        (tmp_path / "bad.toml").write_text(COLUMNS.replace(old, new))
        with pytest.raises(ValueError, match=fault):
            read_log(tmp_path / "bad.toml")


def tones(rate_hz: float, *hz: float) -> Recording:
    time = np.arange(round(4 * rate_hz)) / rate_hz
    wave = sum(np.sin(2 * np.pi * each * time) for each in hz)
    signal = np.stack([wave, 0.5 * wave, -wave], axis=1)
    return Recording("x", "x", time, signal, signal + GRAVITY)


@pytest.mark.parametrize("rate_hz", [100.0, 285.7, 1000.0])
def test_motion_passes_the_resampling_at_any_rate(rate_hz):
    log, _ = resample(tones(rate_hz, 10.0))
    time = log["time"].to_numpy()
    error = log["gyro"].to_numpy()[0, :, 0] - np.sin(2 * np.pi * 10.0 * time)
    assert np.abs(error[20:-20]).max() < 2e-3


def test_vibration_above_the_new_nyquist_frequency_does_not_fold():
    log, report = resample(tones(1000.0, 190.0))  # would fold to 10 Hz
    assert np.abs(log["gyro"].to_numpy()[0, 50:-50]).max() < 5e-3
    assert report.filter_hz == 90.0
    aliased = tones(1000.0, 190.0).gyro[::5, 0]
    assert np.abs(aliased).max() > 0.9


def test_everything_odd_is_counted_and_no_gap_is_bridged():
    log = tones(200.0, 1.0)
    time, gyro = log.time.copy(), np.clip(log.gyro, -0.9, None)
    gyro[100] = gyro[99]
    accel = log.accel.copy()
    accel[100] = accel[99]
    time[140] = time[139]  # a stamp that stands still
    accel[300, 1] = np.nan
    kept = np.ones(time.size, bool)
    kept[400:420] = kept[500:501] = False  # a gap, and a lost sample
    odd = Recording("x", "x", time[kept], gyro[kept], accel[kept])
    even, report = resample(odd)
    assert (report.repeated, report.stamps_back, report.missing) == (1, 1, 1)
    assert (report.gaps, report.lost) == (1, 3)
    assert report.longest_gap_s == pytest.approx(0.105)
    assert any("the longest 0.105 s: left out of scores" in line for line in report.warnings)
    missing = np.flatnonzero(np.isnan(even["gyro"].to_numpy()[0]).any(axis=1))
    assert missing.tolist() == list(range(400, 420))
    assert [fault.kind for fault in report.sensor_faults] == ["saturation", "saturation"]
    assert len(report.warnings) == 8


def test_irregular_stamps_are_evened_by_when_they_were_taken():
    rng = np.random.default_rng(0)
    time = np.sort(np.arange(2000) / 500 + rng.uniform(-0.0005, 0.0005, 2000))
    signal = np.stack([np.sin(2 * np.pi * 5 * time)] * 3, axis=1)
    log, report = resample(Recording("x", "x", time, signal, signal))
    expected = np.sin(2 * np.pi * 5 * (log["time"].to_numpy() + time[0]))
    assert np.abs(log["gyro"].to_numpy()[0, 20:-20, 0] - expected[20:-20]).max() < 2e-3
    assert report.jitter_ms == pytest.approx(0.41, abs=0.05)


def test_allan_variance_is_allantools():
    allantools = pytest.importorskip("allantools")
    signal = np.random.default_rng(0).normal(size=(20_000, 3)).cumsum(axis=0)
    sizes = np.array([1, 10, 300])
    found = allan_variance(signal, 100.0, sizes)
    for axis in range(3):
        _, deviation, *_ = allantools.oadev(signal[:, axis], 100.0, "freq", taus=sizes / 100.0)
        np.testing.assert_allclose(np.sqrt(found[:, axis]), deviation, rtol=1e-9)


def test_model_variance_is_smooth_where_it_is_expanded():
    times = np.array([9.99, 10.01])
    low, high = model_variance(times, 0.0, 1.0, 1000.0)
    assert high / low == pytest.approx(10.01 / 9.99, rel=1e-4)
    assert low == pytest.approx(9.99 / 3, rel=0.01)  # σ_b² t/3 of a pure random walk


def test_an_hour_at_rest_calibrates_the_sensor_that_recorded_it(tmp_path):
    log, imu = at_rest(3600.0)
    found = calibrate(log)
    for sensor, true in ((found.gyro, imu.gyro), (found.accel, imu.accel)):
        assert sensor.noise == pytest.approx(true.noise, rel=0.02)
        assert sensor.random_walk == pytest.approx(true.random_walk, rel=0.2)
        assert true.time_constant is not None
        assert 1 / 2.5 < sensor.time_constant / true.time_constant < 2.5
    np.testing.assert_allclose(found.gyro.bias, log.gyro.mean(axis=0), atol=1e-12)
    write_imu(found, tmp_path / "mine.toml")
    written = load_imu(tmp_path / "mine.toml")
    assert written.gyro.noise == pytest.approx(found.gyro.noise, rel=1e-4)
    assert written.accel.turn_on == pytest.approx(found.accel.turn_on, rel=1e-4)


def at_rest(seconds: float, seed: int = 1) -> tuple[Recording, ImuSpec]:
    """A sensor at rest, tilted, and its model."""
    imu = load_imu("adis16448")
    steps = round(seconds * RATE)
    force = np.tile(quat_rotate_inverse(quat_from_euler(0.1, -0.2, 0.0), GRAVITY), (1, steps, 1))
    gyro, accel = simulate_imu(imu, np.zeros((1, steps, 3)), force, RATE, seed=seed)
    return Recording("still", "x", np.arange(steps) / RATE, gyro[0], accel[0]), imu


def test_half_a_minute_at_rest_gives_the_noise_and_says_what_the_walk_needs():
    log, imu = at_rest(30.0)
    found = calibrate(log)
    for sensor, true in ((found.gyro, imu.gyro), (found.accel, imu.accel)):
        assert sensor.noise == pytest.approx(true.noise, rel=0.1)
        assert sensor.random_walk == 0.0
    along_gravity = abs(np.linalg.norm(log.accel.mean(axis=0)) - 9.81)
    assert found.accel.turn_on == pytest.approx(along_gravity, abs=0.01)
    (line,) = found.lacking
    assert line.startswith("bias random walk and its time constant: need 60 s")


def test_a_walk_that_does_not_show_is_bounded():
    log, imu = at_rest(70.0)
    white = np.random.default_rng(0).normal(0.0, imu.gyro.noise * np.sqrt(RATE), log.gyro.shape)
    found = calibrate(replace(log, gyro=white))
    assert found.gyro.random_walk == 0.0
    (line,) = [each for each in found.lacking if each.startswith("gyroscope, bias random walk")]
    bound = float(line.split("below about ")[1].split(" ")[0])
    assert bound == pytest.approx(4 * np.sqrt(3) * imu.gyro.noise / 70, rel=0.1)


def test_the_seconds_before_take_off_are_at_rest_and_a_hover_with_vibration_is_not():
    log, _ = at_rest(20.0)
    shake = np.random.default_rng(0).normal(0.0, 1.0, log.accel.shape) * (log.time > 12.0)[:, None]
    flown = replace(log, accel=log.accel + shake)
    assert calibrate(flown).still_s == pytest.approx(12.0, abs=1.0)
    late = replace(log, accel=log.accel + shake[::-1] + shake)
    with pytest.raises(ValueError, match=r"still: at rest for \d s at a stretch; at least 10 s are required"):
        calibrate(late)


def test_odd_stamps_at_rest_are_left_out_and_bad_logs_are_one_line():
    log, _ = at_rest(20.0)
    stamps = log.time.copy()
    stamps[500:503], stamps[2000] = stamps[499], np.nan
    found = calibrate(replace(log, time=stamps))
    np.testing.assert_allclose(found.gyro.bias, log.gyro.mean(axis=0), atol=3e-4)
    with pytest.raises(ValueError, match="no noise to measure"):
        calibrate(replace(log, accel=np.tile(GRAVITY, (log.time.size, 1))))
    with pytest.raises(ValueError, match=r"at rest it reads a specific force of 0\.98\d* m/s²"):
        calibrate(replace(log, accel=log.accel / 9.81))


def test_the_command_prints_the_bias_and_writes_an_imu(tmp_path):
    log, _ = at_rest(12.0)
    np.savez(tmp_path / "x.npz", t=log.time, gyro=log.gyro, acc=log.accel)
    out = tmp_path / "mine.toml"
    command = ["identify", str(tmp_path / "x.npz"), "--still", "--out", str(out)]
    done = CliRunner().invoke(app, command, catch_exceptions=False)
    assert all(f"{value:+.5f}" in done.output for value in log.gyro.mean(axis=0))
    assert load_imu(out).gyro.turn_on == pytest.approx(np.sqrt((log.gyro.mean(axis=0) ** 2).mean()), rel=1e-4)
    assert out.with_suffix(".png").is_file()


def test_converted_logs_are_a_dataset_without_their_gaps(tmp_path):
    time, gyro, accel, quat = turning(seconds=10.0)
    kept = np.ones(time.size, bool)
    kept[900:950] = False
    log, _ = resample(Recording("x", "x", time[kept], gyro[kept], accel[kept], "x", time, quat))
    data = open_dataset(convert([log], tmp_path / "x.zarr", piece_s=2.0))
    assert data.sizes["flight"] == 4  # two before the gap, two after
    np.testing.assert_allclose(data["gyro"][2], gyro[950:1350], atol=1e-4)
    assert set(data["valid_steps"].to_numpy()) == {400}
    with pytest.raises(ValueError, match="exists already"):
        convert([log], tmp_path / "x.zarr")
    with pytest.raises(ValueError, match="choose a shorter --piece"):
        convert([log], tmp_path / "y.zarr", piece_s=8.0)


def test_commands_say_what_they_found(tmp_path):
    time, gyro, accel, quat = turning(seconds=5.0)
    np.savez(tmp_path / "x.npz", t=time, gyro=gyro, acc=accel, quat=quat)
    run = CliRunner().invoke
    shown = run(app, ["report", str(tmp_path / "x.npz"), "--mount", "rpy 20 -5 0"])
    assert "IMU's arrays" in shown.output
    assert "OptiTrack" not in shown.output  # which only BROAD has
    assert "nothing odd" in shown.output
    to = ["--format", "zarr", "--out", str(tmp_path / "x.zarr")]
    made = run(app, ["export", str(tmp_path / "x.npz"), *to, "--piece", "2"])
    assert "2 pieces of 2 s, 80 % of 5 s" in made.output


def test_unknown_files_are_one_clear_line(tmp_path):
    (tmp_path / "x.csv").touch()
    with pytest.raises(ValueError, match=r"x.csv: not a log that can be read; write a column map"):
        read_log(tmp_path / "x.csv")
    with pytest.raises(FileNotFoundError, match="no such log"):
        read_log(tmp_path / "absent.ulg")


@pytest.mark.parametrize("kind", ["ulg", "bag", "db3", "mcap", "hdf5", "mat", "npz"])
def test_a_damaged_log_is_one_line_that_names_it(tmp_path, kind):
    path = tmp_path / f"x.{kind}"
    path.write_bytes(b"no log")
    with pytest.raises(ValueError, match=f"x.{kind}") as refused:
        read_log(path)
    assert "\n" not in str(refused.value)
    assert "pickle" not in str(refused.value)  # never advise to load one


@pytest.mark.parametrize("late_s", [-0.033, 0.0, 0.06])
def test_a_late_truth_is_found_to_a_millisecond_and_said(late_s):
    time, gyro, accel, quat = turning(seconds=20.0)
    gyro = gyro + np.random.default_rng(1).normal(0.01, 0.05, gyro.shape)
    seen = shaken(quat, 0.002)
    report = report_of(Recording("x", "test", time, gyro, accel, "mocap", time + late_s, seen))
    assert report.aligned.delay_s == pytest.approx(late_s, abs=1e-3)
    assert any("the truth is" in warning for warning in report.warnings) == (late_s != 0.0)


def shaken(quat: np.ndarray, noise: float) -> np.ndarray:
    """An attitude with white noise [rad] at every sample."""
    return quat_multiply(quat, quat_from_rotvec(np.random.default_rng(0).normal(0.0, noise, (len(quat), 3))))


def gentle(noise: float, swapped: bool = False, scale: float = 0.2) -> Recording:
    """A gentle flight of a minute whose truth has white noise [rad] at every sample."""
    time, rng = np.arange(12_000) / RATE, np.random.default_rng(1)
    roll, pitch, yaw = 0.2 * np.sin(2 * time), 0.3 * np.sin(3 * time), 0.3 * np.sin(time)
    gyro, accel, quat = readings(time, scale * roll, scale * pitch, scale * yaw)
    gyro = gyro + rng.normal(0.0, 0.003, gyro.shape)
    accel = accel + rng.normal(0.0, 0.05, gyro.shape)
    order = [1, 0, 2] if swapped else [0, 1, 2]
    return Recording("x", "test", time, gyro[:, order], accel, "mocap", time, shaken(quat, noise))


@pytest.mark.parametrize("noise", [0.01, 0.025])
def test_a_noisy_truth_of_a_gentle_flight_is_believed_and_one_in_swapped_axes_is_not(noise):
    report = report_of(gentle(noise))
    assert report.aligned.agreement < 0.7  # of rates over a tenth of a second, by the truth's noise
    assert report.faults == []
    assert "does not turn as the gyroscope does" in report_of(gentle(noise, True)).faults[0]
    turned = mounted(gentle(noise), mount_matrix("y,-x,z"))
    assert "with the IMU rotated by 9" in report_of(turned).faults[0]


def test_a_noisy_truth_at_rest_is_not_judged():
    assert report_of(gentle(0.025, scale=0.0)).faults == []


# --- what cannot be right ---


def wrong(name: str) -> Recording:
    """A sensor that turns, and one thing wrong with the log of it."""
    log, upside = turned(), np.array([1.0, -1.0, -1.0])
    time, gyro, accel, quat = log.time, log.gyro, log.accel, log.quat
    changed = {
        "deg/s": {"gyro": np.degrees(gyro)},
        "rad/s as deg/s": {"gyro": np.radians(gyro)},
        "ten times the rate": {"gyro": 10 * gyro},
        "no rate": {"gyro": 0 * gyro},
        "constant force": {"accel": np.broadcast_to([0.0, 0.0, 9.81], accel.shape)},
        "twice the time": {"time": 2 * time, "truth_time": 2 * time},
        "norm": {"quat": 0.7 * quat},
        "g": {"accel": accel / 9.81},
        "mg": {"accel": accel / 9.81e-3},
        "frame": {"gyro": upside * gyro, "accel": upside * accel},
        "frd in ned": {"gyro": upside * gyro, "accel": upside * accel, "quat": swap_enu_flu_ned_frd(quat)},
        "gravity": {"accel": -accel},
        "sign of z": {"gyro": gyro * [1.0, 1.0, -1.0]},
        "upright": {"gyro": gyro[:, [2, 1, 0]] * [1, -1, 1], "accel": accel[:, [2, 1, 0]] * [1, -1, 1]},
        "axes": {"gyro": gyro[:, [1, 2, 0]], "accel": accel[:, [1, 2, 0]]},
    }
    return replace(log, **changed[name])


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("deg/s", 'times the rate at which the truth turns (slope): is it in deg/s (gyro.unit = "deg/s")'),
        ("rad/s as deg/s", 'is it in rad/s (gyro.unit = "rad/s")'),
        ("ten times the rate", "look at its unit"),
        ("no rate", "the gyroscope reads the same number all the time"),
        ("constant force", "the accelerometer reads the same number all the time"),
        ("twice the time", "look at its unit, and at that of the stamps"),
        ("norm", "quaternions have a length of 0.7, not 1"),
        ("g", 'is it in g (accel.unit = "g")?'),
        ("mg", 'is it in mg (accel.unit = "mg")?'),
        ("frame", "with the IMU rotated by 180° it does"),
        ("frd in ned", 'it points down: frame = "frd"'),
        ("gravity", "accel.negate = true"),
        ("axes", "look at frame and mount"),
        ("sign of z", "the gyroscope's z does not read how the truth turns about that axis (correlation -"),
    ],
)
def test_units_norms_and_frames_that_cannot_be_right_are_said(name, said):
    report = report_of(wrong(name))
    assert any(said in fault for fault in report.faults)
    assert report.faults[0] in report.warnings


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("g", 'accel.unit = "g"'),
        ("mg", 'accel.unit = "mg"'),
        ("frame", 'frame = "frd"'),
        ("upright", "is the frame FLU"),
    ],
)
def test_without_truth_the_length_and_direction_of_the_force_are_looked_at(name, said):
    assert said in report_of(blind(wrong(name))).faults[0]


def test_a_log_in_which_nothing_is_wrong_has_no_faults():
    assert report_of(turned()).faults == report_of(blind(turned())).faults == []


def test_noise_of_the_truth_hides_no_wrong_unit_and_makes_none():
    log = turned()
    noisy = replace(log, quat=shaken(log.quat, 0.024))
    report = report_of(noisy)
    assert report.aligned.slope < 0.78  # by the truth's noise alone
    assert report.aligned.slope / report.aligned.agreement == pytest.approx(1.0, rel=0.02)
    assert not any("times the rate" in fault for fault in report.faults)
    in_degrees = report_of(replace(noisy, gyro=np.degrees(log.gyro)))
    assert any('gyro.unit = "deg/s"' in fault for fault in in_degrees.faults)


@pytest.mark.parametrize("with_truth", [True, False])
def test_a_gyroscope_in_degrees_shows_at_rest_too(with_truth):
    rng, still = np.random.default_rng(0), np.tile([0.0, 1.0, 9.75], (4000, 1))
    gyro = np.radians([0.6, -0.4, 0.3]) + rng.normal(0.0, 2e-3, still.shape)
    time = np.arange(4000) / 200
    log = Recording("x", "test", time, gyro, still + rng.normal(0.0, 0.03, still.shape))
    if with_truth:
        log = log.with_truth("truth", time, np.tile(quat_from_euler(0.1, 0, 0), (4000, 1)))
    assert report_of(log).faults == []
    said = report_of(replace(log, gyro=np.degrees(gyro))).faults
    assert any("at rest for 20 s" in fault and 'gyro.unit = "deg/s"' in fault for fault in said)
    biased = report_of(replace(log, gyro=gyro + np.radians([4.6, 0.0, 0.0])))
    assert not any("at rest" in fault for fault in biased.faults)  # a raw bias, and the right unit


@pytest.mark.parametrize("bank_deg", [15.0, 24.0, 40.0])
def test_a_steady_banked_turn_is_not_taken_for_rest(bank_deg):
    time, bank = np.arange(4000) / 200, np.radians(bank_deg)
    rate = np.tile([0.0, 2.0 * np.sin(bank), 2.0 * np.cos(bank)], (4000, 1))  # 2 rad/s about the vertical
    noise = np.random.default_rng(0).normal(0.0, 1e-3, rate.shape)
    force = np.tile([0.0, 0.0, 9.81 / np.cos(bank)], (4000, 1)) + noise
    assert report_of(Recording("x", "test", time, rate + noise, force)).faults == []


def test_a_log_that_cannot_be_right_is_scored_by_force_alone(tmp_path):
    log, out = write_csv(tmp_path, wrong("deg/s")), str(tmp_path / "out")
    for command in (
        ["evaluate", "--logs", log, "--estimator", "mahony", "--out", out],
        ["export", log, "--format", "zarr", "--piece", "5", "--out", f"{out}.zarr"],
    ):
        with pytest.raises(ValueError, match=r"57.3 times the rate.*--force"):
            CliRunner().invoke(app, command, catch_exceptions=False)
        assert CliRunner().invoke(app, [*command, "--force"], catch_exceptions=False).exit_code == 0


@pytest.mark.parametrize(("sensor", "reading"), [("gyro", 1000.0), ("gyro", 1e30), ("accel", 1e30)])
def test_a_spike_is_left_out_and_condemns_no_log(sensor, reading):
    log = turned()
    spoilt = getattr(log, sensor).copy()
    spoilt[900] = reading
    report = report_of(replace(log, **{sensor: spoilt}))
    assert report.faults == []
    assert report.missing == 1


def test_arrays_of_an_imu_without_attitude_are_a_log(tmp_path):
    time, gyro, accel, _ = turning()
    np.savez(tmp_path / "x.npz", t=time, gyro=gyro, acc=accel)
    log, report = reported(tmp_path / "x.npz")
    np.testing.assert_allclose(log["gyro"][0], gyro, atol=1e-12)
    assert report.truth == "none"
    np.savez(tmp_path / "x.npz", gyro=gyro, acc=accel)
    with pytest.raises(ValueError, match="not a BROAD trial; it holds acc, gyro"):
        read_log(tmp_path / "x.npz")


def test_a_damaged_ulog_that_the_library_reads_for_ever_is_refused(tmp_path):
    path = tmp_path / "x.ulg"
    header = b"ULog\x01\x12\x35\x01" + bytes(8)
    unknown = (10).to_bytes(2, "little") + b"Z" + bytes(10)
    cut = (13 * 1000).to_bytes(2, "little") + b"\x00"  # a message of 13 000 bytes, where the file ends
    path.write_bytes(header + unknown * 2000 + cut)
    with pytest.raises(OSError, match="no end of the log is found"):
        read_recording(path)


@pytest.mark.parametrize(
    ("cell", "said"), [("abc", "row 3 of the numbers, column 2: 'abc'"), ("0;1", "delimiter")]
)
def test_a_cell_that_is_no_number_is_named(tmp_path, cell, said):
    path, csv = write_csv(tmp_path, turned(0.1)), tmp_path / "x.csv"
    rows = [line.split(",") for line in csv.read_text().splitlines()]
    rows[3][1] = cell
    csv.write_text("\n".join(map(",".join, rows)))
    with pytest.raises(ValueError, match=said):
        read_recording(path)


def test_real_recordings_agree_with_their_truth_and_raise_no_false_alarm(broad):
    for path in sorted(broad[0].parents[1].glob("*/*.npz"))[2::5]:
        log, report = reported(path)
        assert (report.faults, report.sensor_faults) == ([], ())
        if path in broad:
            assert report.source_rate_hz == pytest.approx(285.7, abs=0.1)
            assert np.linalg.norm(np.subtract(report.gravity, GRAVITY)) < 0.15
            assert log["scored"].any()


def test_one_wrong_stamp_costs_one_sample():
    for jump in (1e6, -1e6, 1e18):
        stamps = turned().time
        stamps[700] += jump
        dataset, report = resample(turned(time=stamps))
        assert dataset.sizes["time"] == stamps.size
        assert (report.gaps, report.lost) == (0, 1)
        consistent(dataset.isel(time=slice(100, 600)))


def test_stamps_of_truth_and_sensors_that_go_back_are_left_out():
    log = turned()
    stamps = log.time - np.where(np.arange(4000) // 10 == 70, 1.0, 0.0)
    dataset = resample(turned(truth_time=stamps, sensors={"mag": Track(stamps, log.accel)}))[0]
    consistent(dataset.isel(time=slice(720, 4000)))
    np.testing.assert_allclose(dataset["mag"][0], log.accel, atol=0.1)


def test_a_truth_of_another_time_is_no_truth():
    assert report_of(turned(truth_time=turned().time + 1e5)).truth_share == 0.0


def test_long_gaps_split_a_log_and_every_part_is_converted():
    time = turned().time
    stamps = time + np.where(time >= 12.0, 1e6, 0.0)
    log = turned(time=stamps, truth_time=stamps)
    dataset, report = resample(log)
    assert report.parts == 2
    assert dataset.sizes["time"] == 2400
    assert "cut this log into 2 parts" in report.warnings[0]
    assert [part.time.size for part in split(log)] == [2400, 1600]


def test_a_log_with_hardly_a_sample_is_refused():
    pairs = np.repeat(np.arange(2000), 2) * 20.0 + np.tile([0.0, 0.005], 2000)
    with pytest.raises(ValueError, match="most of the log is missing"):
        resample(turned(time=pairs))


def test_doublets_of_stamps_are_one_sample_each():
    log = turned()
    doublets = np.repeat(log.time, 2) + np.tile([0.0, 1e-9], 4000)
    gyro = np.repeat(log.gyro, 2, 0) + np.tile([0.0, 1.0], 4000)[:, None]
    dataset, report = resample(turned(time=doublets, gyro=gyro, accel=np.repeat(log.accel, 2, 0)))
    assert report.stamps_back == 4000
    consistent(dataset)


# --- what a recorder does to its samples -------------------------------------------------------------


@pytest.mark.parametrize(("rate_hz", "jitter_ms"), [(200.0, 2.0), (1000.0, 2.0)])
def test_jittering_stamps_are_no_gaps(rate_hz, jitter_ms):
    time, gyro, accel, _ = turning(rate_hz, 20.0)
    stamps = time + np.random.default_rng(0).uniform(-1e-3, 1e-3, time.size) * jitter_ms
    log, report = resample(Recording("x", "x", stamps, gyro, accel))
    assert report.gaps == 0
    assert np.isfinite(log["gyro"]).all()
    if rate_hz == 200.0:
        assert (report.stamps_back, report.lost <= 0.01 * time.size) == (0, True)


def test_repeated_and_backward_stamps_are_left_out_and_rows_out_of_order_are_refused():
    log = turned()
    repeated = log.time.copy()
    repeated[1000:1010] = log.time[999]
    assert report_of(turned(time=repeated)).stamps_back == 10
    absent = np.where(np.arange(4000) % 100 == 0, np.nan, log.time)
    assert report_of(turned(time=absent)).missing == 40
    for stamps, said in (
        (
            np.random.default_rng(0).permutation(log.time),
            r"\d+ % of the stamps go back: sort the rows by time",
        ),
        (np.full(4000, np.nan), "0 usable samples; at least 8 are required"),
        (np.zeros(4000), "1 usable samples whose stamps go forward; at least 8 are required"),
    ):
        with pytest.raises(ValueError, match=f"^x: {said}$"):
            resample(turned(time=stamps))


def noisy() -> Recording:
    """The turning sensor with the noise of a real one."""
    log, rng = turned(), np.random.default_rng(0)
    gyro = log.gyro + rng.normal(0.0, 2e-3, log.gyro.shape)
    return replace(log, gyro=gyro, accel=log.accel + rng.normal(0.0, 0.02, log.accel.shape))


@pytest.mark.parametrize(("sensor", "axis"), [("gyro", 1), ("accel", 0)])
def test_an_axis_that_is_stuck_is_left_out_there_and_refused_if_always(sensor, axis):
    log = noisy()
    readings = getattr(log, sensor).copy()
    readings[1000:1800, axis] = readings[1000, axis]
    dataset, report = resample(replace(log, **{sensor: readings}))
    name = f"the {'gyroscope' if sensor == 'gyro' else 'accelerometer'}'s {'xyz'[axis]}"
    (said,) = [line for line in report.warnings if f"{name} repeats one number for 4.0 s" in line]
    assert said.startswith("5.0 s to 9.0 s: ")
    assert said.endswith(": left out of scores")
    missing = np.isnan(dataset["gyro"][0]).any(axis=1).to_numpy()
    assert missing[1000:1800].all()
    assert missing.sum() < 810
    readings[:, axis] = 0.5
    always = report_of(replace(log, **{sensor: readings}))
    assert f"{name} reads the same number all the time" in always.faults


def test_a_coarse_sensor_at_rest_is_not_stuck():
    rng = np.random.default_rng(0)
    accel = np.round(rng.normal([0.02, 0.04, 9.81], 0.01, (4000, 3)) / 0.08) * 0.08
    gyro = np.round(rng.normal(0.0, 1e-3, (4000, 3)) / 1e-3) * 1e-3
    log, report = resample(Recording("x", "x", np.arange(4000) / 200, gyro, accel))
    assert report.sensor_faults == ()
    assert np.isfinite(log["accel"]).all()


@pytest.mark.parametrize(
    ("rate_hz", "hint"),
    [
        (20.0, ""),
        (32_000.0, ""),
        (0.2, 'are the stamps in ms \\(time.unit = "ms"\\)'),
        (2e-7, 'are the stamps in ns \\(time.unit = "ns"\\)'),
    ],
)
def test_rates_of_no_imu_are_one_line_and_the_unit_of_the_stamps_is_named(rate_hz, hint):
    with pytest.raises(ValueError, match=hint or "samples a second; 40 to 10000 are allowed") as refused:
        report_of(turned(time=np.arange(4000) / rate_hz))
    assert "\n" not in str(refused.value)
