"""Logs of other tools: every format gives the same flight back, in our frames, with what is odd counted."""

import numpy as np
import pytest
from sensor import consistent, reported, turned, turning, write_csv
from ulog_file import write_ulog

from quadsim.dataset.reading import open_dataset
from quadsim.logs import read_log, read_recording
from quadsim.logs.convert import convert
from quadsim.logs.recording import Recording, mount_matrix
from quadsim.logs.resample import resample
from quadsim.rotation import quat_from_euler, roll_pitch_from_quat, swap_enu_flu_ned_frd, swap_flu_frd


def write_euroc(folder, sensor: str = "", truth: str = "state_groundtruth_estimate0") -> None:
    """An EuRoC sequence of the turning sensor; sensor: T_BS of its IMU as YAML."""
    time, gyro, accel, quat = turning()
    stamps = np.rint(time * 1e9)
    for name, values in (("imu0", (gyro, accel)), (truth, (0.0 * gyro, quat))):
        place = folder / "mav0" / name
        place.mkdir(parents=True)
        np.savetxt(place / "data.csv", np.column_stack([stamps, *values]), "%.15g", ",", header="t")
    (folder / "mav0" / "imu0" / "sensor.yaml").write_text(sensor)


@pytest.mark.parametrize("truth", ["state_groundtruth_estimate0", "mocap0", "vicon0"])
def test_an_euroc_folder_is_read(tmp_path, truth):
    write_euroc(tmp_path / "V1", truth=truth)
    log, report = reported(tmp_path / "V1")
    consistent(log)
    assert (log.sizes["time"], report.counts["gaps"], report.counts["truth_share"]) == (800, 0, 1.0)
    assert report.log.truth.startswith(f"{truth}: ")


def test_the_mounting_in_an_euroc_folder_is_undone(tmp_path):
    write_euroc(tmp_path / "V1", "T_BS:\n  data: [0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n")
    gyro = turning()[1]
    log = read_log(tmp_path / "V1")
    np.testing.assert_allclose(log["gyro"][0], gyro @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-5)


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
        assert report.log.truth == "/vicon: poses"
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
    assert report.log.truth == "vehicle_mocap_odometry: motion capture"
    own, report = reported(tmp_path / "x.ulg", truth="vehicle_attitude")
    assert np.abs(roll_pitch_from_quat(own["quat"][0])).max() < 1e-6
    assert "no independent truth" in report.log.truth
    assert "the truth hardly turns where the gyroscope does" in report.warnings
    assert any("frames disagree" in warning for warning in report.warnings)


def test_px4_rotor_speeds_and_magnetometer_are_read_where_they_are_logged(tmp_path):
    time = turning()[0]
    field = np.array([2e-5, -1e-5, -4e-5])  # T, in FLU axes
    rpm = np.tile([2.0, 4000.0, -4100.0], (time[::20].size, 1))  # how many ESCs there are, and their speeds
    gauss = np.tile(swap_flu_frd(field) * 1e4, (time[::4].size, 1))
    escs = "float esc_count;float esc[0].esc_rpm;float esc[1].esc_rpm;"
    topics = {
        "esc_status": (escs, time[::20], rpm),
        "sensor_mag": ("float x;float y;float z;", time[::4], 2.0 * gauss),  # not calibrated
        "vehicle_magnetometer": ("float[3] magnetometer_ga;", time[::4], gauss),
    }
    write_px4(tmp_path / "x.ulg", **topics)
    log = read_log(tmp_path / "x.ulg")
    speeds = np.array([4000.0, 4100.0]) * np.pi / 30
    for name, wanted, least in (("rotor_vel", speeds, 0.9), ("mag", field, 0.0)):
        found = log[name][0].to_numpy()
        known = np.isfinite(found).all(axis=1)
        assert known.mean() > least
        np.testing.assert_allclose(found[known], np.tile(wanted, (known.sum(), 1)), rtol=1e-6, atol=1e-9)


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
        ("z,y,-x", "z,y,x", "mount z,y,x: no rotation"),
    ):
        (tmp_path / "bad.toml").write_text(COLUMNS.replace(old, new))
        with pytest.raises(ValueError, match=fault):
            read_log(tmp_path / "bad.toml")


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


def test_commands_say_what_they_found(tmp_path, printed):
    time, gyro, accel, quat = turning(seconds=5.0)
    np.savez(tmp_path / "x.npz", t=time, gyro=gyro, acc=accel, quat=quat)
    shown = printed("report", "x.npz", "--mount", "rpy 20 -5 0")
    assert "IMU's arrays" in shown
    assert "OptiTrack" not in shown  # which only BROAD has
    assert "nothing odd" in shown
    made = printed("export", "x.npz", "--format", "zarr", "--out", "x.zarr", "--piece", 2)
    assert "2 pieces of 2 s, 80 % of 5 s" in made


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


def test_arrays_of_an_imu_without_attitude_are_a_log(tmp_path):
    time, gyro, accel, _ = turning()
    np.savez(tmp_path / "x.npz", t=time, gyro=gyro, acc=accel)
    log, report = reported(tmp_path / "x.npz")
    np.testing.assert_allclose(log["gyro"][0], gyro, atol=1e-12)
    assert report.log.truth == "none"
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
