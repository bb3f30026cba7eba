"""Logs of ArduPilot and in MCAP: the turning sensor is read back in our axes and units."""

import json
import struct

import numpy as np
import pytest
from sensor import consistent, reported, turning

from quadsim.logs import read_recording
from quadsim.rotation import euler_from_quat, swap_enu_flu_ned_frd, swap_flu_frd

FORMATS = {
    128: ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
    1: ("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    3: ("SIM", "Qffffffffff", "TimeUS,Roll,Pitch,Yaw,Alt,Lat,Lng,Q1,Q2,Q3,Q4"),
    4: ("MAG", "QBhhh", "TimeUS,I,MagX,MagY,MagZ"),
    5: ("ESC", "QBf", "TimeUS,Instance,RPM"),
    6: ("GPS", "QBIHB", "TimeUS,I,GMS,GWk,Status"),
    7: ("ATT", "Qfff", "TimeUS,Roll,Pitch,Yaw"),
}
CODES = {code: code for code in "QBfhHI"} | {"c": "h", "C": "H", "n": "4s", "N": "16s", "Z": "64s"}


def message(kind, *values):
    codes = "".join(CODES[code] for code in FORMATS[kind][1])
    return b"\xa3\x95" + struct.pack(f"<B{codes}", kind, *values)


def write_bin(path, kinds=(1, 3, 4, 5, 7)):
    """A DataFlash log of the turning sensor, with a second IMU that reads nothing and a level SIM or ATT."""
    data = b""
    for kind in (128, 6, *kinds):
        name, codes, names = FORMATS[kind]
        length = 3 + struct.calcsize("<" + "".join(CODES[code] for code in codes))
        data += message(128, kind, length, name.encode(), codes.encode(), names.encode())
    time, gyro, accel, quat = turning()
    frd = swap_enu_flu_ned_frd(quat)
    euler = np.degrees(euler_from_quat(frd))
    for k, us in enumerate((1e6 + time * 1e6).round().astype(int).tolist()):
        of_kind = {
            1: [
                message(1, us, 1, *np.zeros(6)),
                message(1, us, 0, *swap_flu_frd(gyro[k]), *swap_flu_frd(accel[k])),
            ],
            3: [message(3, us, *np.zeros(6), *frd[k])],
            4: [message(4, us, 0, 200, -100, 400)],
            5: [message(5, us, number, 3000.0 * (number + 1)) for number in (1, 0)],
            7: [message(7, us, *euler[k])],
        }
        data += b"".join(part for kind in kinds for part in of_kind[kind]) + message(6, us, 0, 0, 0, 0)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("kinds", "truth"),
    [
        ((1, 3, 7), "SIM: the simulator's truth"),
        ((1, 7), "ATT: the autopilot's own estimate, which is no independent truth"),
    ],
)
def test_an_ardupilot_log_is_turned_from_frd_and_ned(tmp_path, kinds, truth):
    log, report = reported(write_bin(tmp_path / "x.BIN", kinds))
    consistent(log)
    assert (report.log.truth, report.log.truth_axes) == (truth, "body" if 3 in kinds else "imu")
    assert not [warning for warning in report.warnings if "damaged" in warning]


def test_rotor_speeds_and_magnetic_field_of_an_ardupilot_log_are_read(tmp_path):
    log = read_recording(write_bin(tmp_path / "x.bin"))
    np.testing.assert_allclose(log.sensors["rotor_vel"].values[5], np.array([1, 2]) * 100 * np.pi, rtol=1e-6)
    np.testing.assert_allclose(log.sensors["mag"].values[5], [2e-5, 1e-5, -4e-5])  # FLU


def test_an_ardupilot_log_is_what_pymavlink_reads(tmp_path):
    reader = pytest.importorskip("pymavlink.DFReader")
    log = read_recording(write_bin(tmp_path / "x.bin"))
    other, rows = reader.DFReader_binary(str(tmp_path / "x.bin")), []
    names = [f"{name}{axis}" for name in ("Gyr", "Acc") for axis in "XYZ"]
    while (found := other.recv_match(type="IMU")) is not None:
        if found.I == 0:
            rows.append([found.TimeUS * 1e-6, *(getattr(found, name) for name in names)])
    mine = np.column_stack([log.time, swap_flu_frd(log.gyro), swap_flu_frd(log.accel)])
    np.testing.assert_array_equal(mine, rows)


def test_damage_in_an_ardupilot_log_is_skipped_and_counted(tmp_path):
    whole = read_recording(write_bin(tmp_path / "x.bin"))
    data = (tmp_path / "x.bin").read_bytes()
    middle = data.index(b"\xa3\x95\x01", len(data) // 2)
    (tmp_path / "x.bin").write_bytes(data[:middle] + b"\xa3\x00noise" + data[middle:-3])
    log = read_recording(tmp_path / "x.bin")
    np.testing.assert_array_equal(log.gyro, whole.gyro)
    assert f"damaged: {7 + len(message(6, 0, 0, 0, 0, 0)) - 3} bytes are of no message" in log.notes


def test_an_ardupilot_log_without_an_imu_names_what_it_has(tmp_path):
    with pytest.raises(ValueError, match=r"no IMU with TimeUS in this log; messages: ATT, GPS"):
        read_recording(write_bin(tmp_path / "x.bin", (7,)))


def write_json_mcap(path, encoding="json"):
    """Messages as Foxglove has them in JSON: the turning sensor in /imu, its pose in /body, /level."""
    writer_of = pytest.importorskip("mcap.writer").Writer
    time, gyro, accel, quat = turning()
    with path.open("wb") as stream:
        writer = writer_of(stream)
        writer.start()
        channels = {}
        pose = "foxglove.PoseInFrame"
        for topic, kind in {"/imu": "sensor_msgs/Imu", "/body": pose, "/level": pose}.items():
            schema = writer.register_schema(kind, "jsonschema" if encoding == "json" else encoding, b"{}")
            channels[topic] = writer.register_channel(topic, encoding, schema)
        for k, ns in enumerate((1e9 * (time + 1.0)).round().astype(int).tolist()):
            (w, x, y, z), stamp = quat[k].tolist(), dict(zip(("sec", "nsec"), divmod(ns, 10**9), strict=True))
            xyz = [dict(zip("xyz", each[k].tolist(), strict=True)) for each in (gyro, accel)]
            turn = {"x": x, "y": y, "z": z, "w": w}
            none = {"x": 0.0, "y": 0.0, "z": 0.0}
            pose = {"pose": {"position": none, "orientation": turn}}
            level = {"pose": {"position": none, "orientation": none | {"w": 1.0}}}
            read = dict(zip(("angular_velocity", "linear_acceleration"), xyz, strict=True))
            said = {
                "/imu": {"header": {"stamp": stamp}} | read,
                "/body": {"timestamp": stamp, "frame_id": "world"} | pose,
                "/level": {"timestamp": stamp} | level,
            }
            for topic, content in said.items():
                writer.add_message(channels[topic], ns + 7_000_000, json.dumps(content).encode(), ns)
        writer.finish()
    return path


def test_json_messages_of_an_mcap_file_are_read_by_their_own_stamps(tmp_path):
    log, report = reported(write_json_mcap(tmp_path / "x.mcap"))
    consistent(log)
    assert report.log.truth == "/body: poses"
    level, _ = reported(tmp_path / "x.mcap", truth="/level")
    np.testing.assert_allclose(level["quat"][0, :, 0], 1.0)
    said = r'no topic "/odom" of the right kind; topics: /body \(foxglove.PoseInFrame\)'
    with pytest.raises(ValueError, match=said):
        read_recording(tmp_path / "x.mcap", truth="/odom")


def test_messages_of_ros_1_in_an_mcap_file_are_read(tmp_path):
    writer_of = pytest.importorskip("mcap.writer").Writer
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    kinds, time, gyro, accel = store.types, *turning()[:3]
    stamped, vector = kinds["builtin_interfaces/msg/Time"], kinds["geometry_msgs/msg/Vector3"]
    turn = kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 0.0)
    with (tmp_path / "x.mcap").open("wb") as stream:
        writer = writer_of(stream)
        writer.start()
        definition = store.generate_msgdef("sensor_msgs/msg/Imu")[0].encode()
        schema = writer.register_schema("sensor_msgs/Imu", "ros1msg", definition)
        channel = writer.register_channel("/imu", "ros1", schema)
        for k, ns in enumerate((1e9 * (time + 1.0)).round().astype(int).tolist()):
            head = kinds["std_msgs/msg/Header"](k, stamped(*divmod(ns, 10**9)), "imu")
            none = np.zeros(9)
            read = (vector(*gyro[k]), none, vector(*accel[k]), none)
            imu = kinds["sensor_msgs/msg/Imu"](head, turn, none, *read)
            writer.add_message(channel, ns, bytes(store.serialize_ros1(imu, "sensor_msgs/msg/Imu")), ns)
        writer.finish()
    log = read_recording(tmp_path / "x.mcap")
    np.testing.assert_allclose(np.hstack([log.gyro, log.accel]), np.hstack([gyro, accel]), atol=1e-12)
    assert log.truth == "none"


def test_an_mcap_file_in_another_encoding_or_cut_off_is_one_line(tmp_path):
    with pytest.raises(ValueError, match="messages in protobuf; JSON and ROS can be read"):
        read_recording(write_json_mcap(tmp_path / "x.mcap", "protobuf"))
    data = write_json_mcap(tmp_path / "x.mcap").read_bytes()
    (tmp_path / "x.mcap").write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match=r"x\.mcap: damaged, or cut off: .* `mcap recover`"):
        read_recording(tmp_path / "x.mcap")
