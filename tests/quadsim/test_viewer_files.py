"""Files for viewers: what is written of a flight is what the viewers' own libraries read."""

import json
import sys

import numpy as np
import pytest
from sensor import turning

from quadsim.logs import read_recording
from quadsim.pictures.timeline import (
    COLOURS,
    PALETTE,
    SpikeRaster,
    Timeline,
    Trace,
    attitudes,
    axes_of,
    outline,
    styles,
    viewer_files,
)
from quadsim.rotation import euler_from_quat
from quadsim.vehicle import load_vehicle

GATES = SpikeRaster(np.array([0.00125]), np.array([4]))
SPIKES = SpikeRaster(np.array([0.0, 0.0, 0.00125, 0.5]), np.array([3, 7, 3, 1]))
REQUIRED = {
    *("timestamp", "frame_id", "id", "lifetime", "frame_locked", "metadata", "arrows", "cubes", "spheres"),
    *("cylinders", "lines", "triangles", "texts", "models"),
}
"""What Foxglove's schema requires of an entity of a scene."""


def timeline(**changed) -> Timeline:
    """The turning sensor, an estimate with a standard deviation of 2°, and some spikes."""
    time, gyro, accel, quat = turning()
    euler, position = euler_from_quat(quat), np.stack([time, 2 * time, 0 * time], axis=1)
    euler[:10] = np.nan
    estimate = euler_from_quat(quat)[:, :2] + 0.1
    poses, traces = attitudes(
        euler, {"my est": estimate}, {"my est": np.full_like(estimate, np.radians(2.0))}
    )
    traces |= {"gyroscope": axes_of("rad/s", gyro), "rotor speed": Trace("rad/s", {"rotor 0": 400 + time})}
    given = {"time": time, "vehicle": load_vehicle("hummingbird"), "position": position, "poses": poses}
    given |= {
        "gyro": gyro,
        "accel": accel,
        "traces": traces,
        "spikes": {"vectors": SPIKES, "my gates": GATES},
    }
    return Timeline(**given | {"target": position, "wind": position} | changed)


def written(tmp_path, name, shown):
    kinds = {"rerun": None, "mcap": None} | {
        {"rrd": "rerun", "mcap": "mcap"}[name.split(".")[1]]: tmp_path / name
    }
    with viewer_files(**kinds) as write:
        write(shown)
    assert [each.name for each in tmp_path.iterdir()] == [name]
    return tmp_path / name


def test_the_traces_of_an_estimator_are_one_standard_deviation_wide():
    roll = timeline().traces["roll"].curves
    np.testing.assert_allclose(roll["my est plus sigma"] - roll["my est minus sigma"], 4.0)
    np.testing.assert_allclose((roll["my est"] - roll["true"])[10:], np.degrees(0.1))
    assert np.isnan(roll["true"][:10]).all()


def test_errors_of_an_estimator_are_within_half_a_turn_and_around_zero():
    euler, estimate = np.array([[3.1, 0.1, 0.0]]), np.array([[-3.1, 0.3]])
    _, traces = attitudes(euler, {"x": estimate}, {"x": np.radians([[2.0, 3.0]])})
    error = traces["error of roll"].curves
    assert set(error) == {"x", "x plus sigma", "x minus sigma"}
    np.testing.assert_allclose([error["x"], error["x minus sigma"]], [[np.degrees(2 * np.pi - 6.2)], [-2.0]])
    np.testing.assert_allclose(traces["error of pitch"].curves["x"], np.degrees(0.2))
    _, without = attitudes(euler * np.nan, {"x": estimate}, {})
    assert set(without) == {"roll", "pitch"}


def test_a_curve_has_the_colour_of_its_estimator_and_a_bound_that_of_its_curve():
    poses = ["body", "a", "b"]
    assert styles(["true", "b", "b plus sigma"], poses) == [
        (COLOURS["true"], False), (PALETTE[1], False), (PALETTE[1], True)
    ]  # fmt: skip
    assert styles(["x", "y", "y set-point"], poses) == [
        (PALETTE[0], False), (PALETTE[1], False), (PALETTE[1], True)
    ]  # fmt: skip


def test_an_outline_reaches_every_propeller():
    vehicle = load_vehicle("hummingbird")
    circles = outline(vehicle)[-len(vehicle.rotors) :]
    np.testing.assert_allclose([circle[:-1].mean(axis=0) for circle in circles], vehicle.hubs, atol=1e-12)


def test_an_mcap_file_is_read_back_as_a_log(tmp_path):
    pytest.importorskip("mcap")
    shown = timeline(gyro=np.where(np.arange(800)[:, None] == 400, np.nan, timeline().gyro))
    log = read_recording(written(tmp_path, "x.mcap", shown))
    sampled = np.arange(800) != 400
    np.testing.assert_array_equal(
        np.hstack([log.gyro, log.accel]), np.hstack([shown.gyro, shown.accel])[sampled]
    )
    np.testing.assert_allclose(log.time, shown.time[sampled], atol=1e-9)
    assert log.truth == "/body: poses"
    np.testing.assert_array_equal(log.quat, shown.poses["body"][10:])
    np.testing.assert_array_equal(log.position, shown.position[10:])


def test_topics_of_an_mcap_file_keep_their_schemas_and_the_order_of_time(tmp_path):
    reader_of = pytest.importorskip("mcap.reader").make_reader
    found, order, schemas = {}, [], {}
    with written(tmp_path, "x.mcap", timeline()).open("rb") as stream:
        reader = reader_of(stream)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append(json.loads(message.data))
            schemas[channel.topic] = schema.name, json.loads(schema.data)["properties"]
            order.append(message.log_time)
    assert order == sorted(order)
    assert {topic: name for topic, (name, _) in schemas.items() if not topic.startswith("/traces")} == {
        "/body": "foxglove.PoseInFrame",
        "/frames/body": "foxglove.FrameTransform",
        "/frames/my_est": "foxglove.FrameTransform",
        "/scene": "foxglove.SceneUpdate",
        "/imu": "sensor_msgs/Imu",
        "/spikes": "spikes",
    }
    assert all(
        set(message) <= set(schemas[topic][1]) for topic, messages in found.items() for message in messages
    )
    with pytest.raises(ValueError, match=r"topics: .*/traces/gyroscope \(gyroscope \[rad/s\]"):
        read_recording(tmp_path / "x.mcap", truth="/nope")
    assert schemas["/traces/roll"][0] == "roll [deg]"
    assert set(found["/traces/roll"][20]) == {
        "timestamp",
        "true",
        "my_est",
        "my_est_plus_sigma",
        "my_est_minus_sigma",
    }
    assert "true" not in found["/traces/roll"][0]
    assert [each["vectors"] for each in found["/spikes"]] == [[3, 7], [3], [1]]
    assert ["my_gates" in each for each in found["/spikes"]] == [False, True, False]
    assert found["/spikes"][1]["timestamp"] == {"sec": 0, "nsec": 1_250_000}
    (scene,) = found["/scene"]
    assert set(scene) == {"entities", "deletions"}
    assert all(set(each) == REQUIRED for each in scene["entities"])
    assert [each["frame_id"] for each in scene["entities"]] == ["body", "my est"]
    frames = [{each["child_frame_id"] for each in found[f"/frames/{name}"]} for name in ("body", "my_est")]
    assert frames == [{"body"}, {"my est"}]


def test_a_recording_of_rerun_has_poses_traces_and_spikes(tmp_path):
    reader_of = pytest.importorskip("rerun.chunk").RrdReader
    shown, found = timeline(), {}
    for chunk in reader_of(written(tmp_path, "x.rrd", shown)).stream().to_chunks():
        batch = chunk.to_record_batch()
        found |= {(chunk.entity_path, name.split(":")[-1]): batch.column(name) for name in batch.schema.names}
    times = found["/world/body", "time"].to_numpy().astype("m8[ns]").astype(float) * 1e-9
    np.testing.assert_allclose(times, shown.time[10:], atol=1e-9)
    quat = np.stack(found["/world/body", "quaternion"].flatten().to_numpy(zero_copy_only=False))
    np.testing.assert_allclose(quat, shown.poses["body"][10:, [1, 2, 3, 0]], atol=1e-6)
    assert found["/traces/roll", "names"].to_pylist() == [list(shown.traces["roll"].curves)]
    scalars = np.array(found["/traces/roll", "scalars"].to_pylist())
    np.testing.assert_array_equal(scalars, np.stack(list(shown.traces["roll"].curves.values()), axis=1))
    assert found["/spikes/vectors", "scalars"].to_pylist() == [[3.0], [7.0], [3.0], [1.0]]
    assert found["/spikes/my\\ gates", "scalars"].to_pylist() == [[12.0]]  # above the last of the others
    assert found["/spikes/my\\ gates", "names"].to_pylist() == [["my gates: 8–12"]]
    assert len(found["/world/my\\ est/outline", "strips"].to_pylist()[0]) == len(outline(shown.vehicle))


@pytest.mark.parametrize(
    ("rerun", "mcap", "said"),
    [
        ("x.mcap", None, r"x\.mcap: should end in \.rrd"),
        (None, "x.rrd", r"x\.rrd: should end in \.mcap"),
        (None, "folder.mcap", "Is a directory"),
        (None, "file/x.mcap", "Not a directory"),
        (None, "/proc/x.mcap", "no file can be made there"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused_before_there_is_anything_to_write(
    tmp_path, monkeypatch, rerun, mcap, said
):
    monkeypatch.setitem(sys.modules, "mcap", sys)
    monkeypatch.setitem(sys.modules, "mcap.writer", sys)
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "file").touch()
    paths = [None if each is None else tmp_path / each for each in (rerun, mcap)]
    with pytest.raises((ValueError, OSError), match=said), viewer_files(*paths):
        raise AssertionError("nothing was refused")


def test_without_a_file_nothing_is_shown():
    with viewer_files(None, None) as write:
        assert write is None
