"""Faults in flight: of readings, of the airframe, and of its rotors."""

import numpy as np
import pytest
from missions import HOVER, flown, with_faults

from quadsim.estimator import Readings
from quadsim.flight.faults import displaced, sensor_faults
from quadsim.flight.mission import Mission
from quadsim.flight.vehicle_faults import ThrustLoss
from quadsim.imu.spec import load_imu
from quadsim.seeding import vehicle_seeds


def corrupted(fault: dict, samples: int, n: int = 1, value: float = 1.0) -> np.ndarray:
    """Gyro and accel side by side, (samples, n, 6), of a constant reading under a fault at 100 Hz."""
    corrupt = sensor_faults(with_faults(fault).faults, n, 100.0, 0)
    assert corrupt is not None
    out = np.empty((samples, n, 6))
    for k in range(samples):
        readings = Readings(np.full((n, 3), value + k), np.full((n, 3), value + k))
        corrupt(readings, np.full(n, k))
        out[k] = np.hstack([readings.gyro, readings.accel])
    return out


def test_bias_step_adds_to_its_sensor_from_its_time_on():
    out = corrupted({"kind": "bias", "gyro_deg": (0.0, 180.0, 0.0), "at_s": 0.03}, 5, value=0.0)
    ideal = np.arange(5.0)[:, None, None] * np.ones((1, 1, 6))
    np.testing.assert_allclose(out[:3], ideal[:3])
    np.testing.assert_allclose((out - ideal)[3:, 0, :3], [[0.0, np.pi, 0.0]] * 2)
    np.testing.assert_allclose((out - ideal)[..., 3:], 0.0)


def test_a_bias_ramp_grows_evenly_and_then_stays():
    ramp = {"kind": "bias", "gyro_deg": [10.0, 0, 0], "accel": [0, 0, 2.0], "at_s": 0.1, "length_s": 0.2}
    change = corrupted(ramp, 40)[:, 0] - (1.0 + np.arange(40))[:, None]
    share = np.clip((np.arange(40) - 10) / 20, 0, 1)
    np.testing.assert_allclose(change[:, 0], np.radians(10.0) * share, atol=1e-12)
    np.testing.assert_allclose(change[:, 5], 2.0 * share, atol=1e-12)
    assert (change[:, [1, 2, 3, 4]] == 0).all()


def test_a_lever_arm_adds_to_the_imu_s_own():
    imu = load_imu("adis16448").model_copy(update={"lever_arm": (0.01, 0.0, 0.0)})
    arms = with_faults(*[{"kind": "lever-arm", "position": [0.02, 0.03, 0.0]}] * 2).faults
    np.testing.assert_allclose(displaced(imu, arms).lever_arm, (0.05, 0.06, 0.0))
    assert displaced(imu, ()) is imu


def test_near_the_ground_the_rotors_push_harder():
    mission = Mission(with_faults({"kind": "ground-effect"}), None, 4)
    mission.begin(vehicle_seeds(0, 4))
    radius = mission.vehicle.frame.prop_radius
    heights = np.array([0.1, 0.5, 1.0, 100.0]) * radius
    mission.plant.position[:, 2] = heights
    mission._faults.apply(mission.k)
    effect = mission.plant.rotor_effect[:, 0]
    np.testing.assert_allclose(effect, 1 / (1 - (1 / (4 * np.array([0.5, 0.5, 1.0, 100.0]))) ** 2))
    mission._faults.restart(np.array([1]), mission.vehicle.mass)
    assert mission.plant.rotor_effect[1, 0] == 1.0


@pytest.mark.parametrize(
    ("fault", "read"),
    [
        ({"kind": "stuck", "at_s": 0.02, "length_s": 0.03}, [1, 2, 2, 2, 2, 6, 7]),
        ({"kind": "stuck", "at_s": 0.01, "length_s": 0.01, "every_s": 0.03}, [1, 1, 3, 4, 4, 6, 7, 7]),
        ({"kind": "delay", "delay_s": 0.02}, [1, 1, 1, 2, 3, 4]),
    ],
)
def test_a_fault_gives_the_samples_of_earlier_instants(fault, read):
    np.testing.assert_array_equal(corrupted(fault, len(read))[:, 0, 0], read)


def test_saturation_clips():
    out = corrupted({"kind": "saturation", "accel": 3.0}, 6)
    np.testing.assert_array_equal(out[:, 0, 5], [1, 2, 3, 3, 3, 3])
    np.testing.assert_array_equal(out[:, 0, 0], [1, 2, 3, 4, 5, 6])


ON_IMU = (
    {"kind": "stuck", "at_s": 0.02, "length_s": 1.0},
    {"kind": "dropout", "probability": 1.0, "at_s": 0.0},
    {"kind": "delay", "delay_s": 0.02},
)
ON_AXES = (
    *ON_IMU,
    {"kind": "vibration", "frequency_hz": 7.3, "accel": 2.0, "gyro_deg": 90.0, "at_s": 0.0},
    {"kind": "saturation", "accel": 3.0, "gyro_deg": 100.0},
)


ON_PARTS = [
    *((fault, {"sensor": "gyro"}, [1, 1, 1, 0, 0, 0]) for fault in ON_IMU),
    *((fault, {"sensor": "accel"}, [0, 0, 0, 1, 1, 1]) for fault in ON_IMU),
    *((fault, {"sensor": "gyro", "axes": "z"}, [0, 0, 1, 0, 0, 0]) for fault in ON_IMU),
    *((fault, {"axes": "xz"}, [1, 0, 1, 1, 0, 1]) for fault in ON_AXES),
    *((fault, {}, [1, 1, 1, 1, 1, 1]) for fault in ON_AXES),
]


@pytest.mark.parametrize(("fault", "part", "changed"), ON_PARTS)
def test_a_fault_of_some_readings_leaves_the_others_alive(fault, part, changed):
    readings, changed = np.arange(1.0, 9.0)[:, None], np.array(changed, bool)
    out, whole = (corrupted(each, 8)[:, 0] for each in (fault | part, fault))
    np.testing.assert_array_equal((out != readings).any(axis=0), changed)
    np.testing.assert_array_equal(out[:, changed], whole[:, changed])
    assert (whole != readings).any(axis=0).all()


def test_faults_of_two_sensors_do_not_disturb_each_other():
    faults = (
        {"kind": "stuck", "at_s": 0.0, "length_s": 1.0, "sensor": "gyro"},
        {"kind": "delay", "delay_s": 0.01, "sensor": "accel"},
    )
    corrupt = sensor_faults(with_faults(*faults).faults, 1, 100.0, 0)
    for k in range(5):
        readings = Readings(np.full((1, 3), 1.0 + k), np.full((1, 3), 1.0 + k))
        corrupt(readings, np.array([k]))
        np.testing.assert_array_equal(readings.gyro, np.full((1, 3), 1.0))
        np.testing.assert_array_equal(readings.accel, np.full((1, 3), max(k, 1.0)))


def test_dropouts_come_at_their_rate_and_last_their_time():
    fault = {"kind": "dropout", "probability": 0.1, "length_s": 0.03, "at_s": 0.0}
    lost = np.isnan(corrupted(fault, 2000, n=4)).all(axis=2)
    starts = np.diff(lost.astype(int), axis=0) == 1
    assert starts.sum() == pytest.approx(0.1 * (~lost).sum(), rel=0.15)
    runs = lost.sum() / (starts.sum() + lost[0].sum())
    assert runs == pytest.approx(3.0 / 0.9, rel=0.1)  # one may begin where another ends


def test_vibration_has_its_amplitude_and_a_phase_of_its_own():
    shaking = {"kind": "vibration", "frequency_hz": 7.3, "accel": 2.0, "gyro_deg": 90.0, "at_s": 1.0}
    wave = corrupted(shaking, 1100, n=2, value=0.0) - np.arange(1100.0)[:, None, None]
    assert not wave[:100].any()
    amplitude = np.repeat([np.pi / 2, 2.0], 3)
    rms = np.sqrt((wave[100:] ** 2).mean(axis=0))
    np.testing.assert_allclose(rms, np.tile(amplitude / np.sqrt(2), (2, 1)), rtol=0.02)
    assert np.abs(wave[100, 0] - wave[100, 1]).max() > 1e-3


def test_controller_holds_its_rate_while_samples_are_missing():
    mission = flown(with_faults({"kind": "dropout", "probability": 1.0, "at_s": 0.5}))
    assert np.isnan(mission.readings.gyro).all()
    assert np.isfinite(mission.measured_state["gyro"]).all()
    assert np.isfinite(mission.plant.position).all()


def test_a_rotor_that_the_vehicle_lacks_cannot_be_lost():
    with pytest.raises(ValueError, match="rotor = 4: this vehicle has rotors 0 to 3"):
        flown(
            HOVER.model_copy(
                update={"faults": (ThrustLoss(kind="thrust-loss", rotor=4, effect=0.5, at_s=1.0),)}
            )
        )


def test_rotors_fade_and_break_as_told():
    faults = [
        {"kind": "thrust-loss", "effect": 0.8, "at_s": 0.0, "fade_s": 0.5},
        {"kind": "thrust-loss", "rotor": 2, "effect": 0.5, "at_s": 0.9},
    ]
    mission = flown(with_faults(*faults))
    np.testing.assert_allclose(mission.plant.rotor_effect, [[0.8, 0.8, 0.4, 0.8]] * 2)
