"""The tilt at an unknown start and the biases of both sensors, from drag and from rests."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from estimators.alignment import (
    ACCEL_BIAS,
    ACCEL_BIAS_MAX,
    ACCEL_BIAS_WALK,
    AIR,
    AIRS_S,
    BIAS,
    BIAS_MAX,
    BIAS_WALK,
    BREATH,
    BREATH_MIN,
    BREATH_S,
    BREEZE,
    BREEZE_S,
    CALM,
    CLIMB,
    CLIMB_FROM_S,
    CLIMB_S,
    CLIMBS_S,
    CORRECTED_S,
    DRAG_ERROR,
    EFFECT,
    ENOUGH,
    EXPECTED_S,
    FALL_S,
    FRAME,
    GAUGE,
    GAUGE_FROM_S,
    GUST,
    GUSTS_S,
    JUMP,
    JUMP_GAIN,
    JUMP_S,
    KEPT,
    LASTS_MORE,
    LEAN,
    LEAN_MAX,
    LEANT_S,
    MODEL,
    NOISE_S,
    REMEMBERED_S,
    REST_NOISE,
    REST_S,
    SPEED,
    SPEED_MIN,
    SPEED_S,
    SPEED_SD,
    SPEEDS_S,
    SPREAD,
    STATE,
    SUDDEN,
    SUDDEN_S,
    THRUST_S,
    TOLD_SD,
    TOLD_SPEED,
    TOLD_TURN,
    TURN_ERROR,
    TURN_NOISE,
    TURNS_S,
    YAW_BIAS,
    YAW_RATE,
    YAW_RATE_MIN,
    YAW_S,
    follow,
)
from estimators.encoder import ALIGNMENT, HEADING, HELD, INPUT_ONE, known_to, lean_found, scaled_inputs
from estimators.networks import NetworkEstimator, Spiking
from estimators.tilt import tilt_of as tilt_of_roll_pitch
from estimators.weights_file import InputScaling, shipped_network
from quadsim.vehicle import GRAVITY

STEP, DRAG, BIAS_SPREAD, ACCEL_SPREAD = 0.005, 0.25, 0.05, 0.2


def found(
    gyro, accel, heading=None, noise=0.01, drag=DRAG, accel_spread=ACCEL_SPREAD, told_tilt=None, align_s=0.0
):
    """What is kept (T, KEPT) after each of the readings (T, 3) twice, and the turns that are told (T, 2)."""
    kept, out, told = np.zeros(KEPT), np.empty((len(gyro), KEPT)), np.empty((len(gyro), 2))
    if told_tilt is not None:
        kept[0], kept[LEAN : LEAN + 2] = np.inf, (told_tilt[1], -told_tilt[0])
    alignment = align_s, drag, noise, BIAS_SPREAD, accel_spread
    heading = np.zeros(len(gyro)) if heading is None else heading
    for t, (rates, forces, angle) in enumerate(zip(gyro, accel, heading, strict=True)):
        told[t] = follow(rates, forces, np.cos(angle), np.sin(angle), STEP, alignment, kept)
        kept[0] += STEP
        out[t] = kept
    return out, told


def tilt_of(kept):
    """Sine of the tilt about x and y."""
    return np.stack([-kept[..., LEAN + 1], kept[..., LEAN]], -1)


def variances(kept):
    """Of force, lean, both biases and speed, of each axis."""
    return kept[..., SPREAD:EFFECT:12]


def leaning(tilt):
    """Rotation from body to level axes: the shortest, to a body whose tilt has this sine (2,)."""
    sine = np.linalg.norm(tilt)
    axis = np.array([*tilt, 0.0]) / max(sine, 1e-12)
    return Rotation.from_rotvec(np.arcsin(min(sine, 1.0)) * axis)


def flight(
    steps,
    seed=0,
    start=(0.0, 0.0),
    bias=(0.0, 0.0),
    wind=(0.0, 0.0),
    yaw=0.0,
    gust=0.0,
    accel_bias=(0.0, 0.0),
    climb=0.0,
    roll=0.3,
):
    """A rigid body whose tilt wanders, that drag slows: readings (T, 3) twice, heading (T,), sine (T, 2)."""
    rng = np.random.default_rng(seed)
    hz, phase = rng.uniform(0.2, 1.0, (2, 2, 3)), rng.uniform(0, 2 * np.pi, (2, 3))
    time = STEP * np.arange(steps)
    turning = roll * np.cos(2 * np.pi * hz[0] * time[:, None, None] + phase).sum(-1)
    turning[0] = 0.0
    heading = yaw * time
    lateral = np.exp(-1j * heading) * (turning[:, 0] + 1j * turning[:, 1])
    rates = np.stack([lateral.real, lateral.imag, np.full(steps, yaw)], -1)
    turns = Rotation.from_rotvec(STEP * (rates[1:] + rates[:-1]) / 2)
    attitude, velocity = leaning(np.asarray(start)), np.zeros(3)
    air = np.array([*wind, 0.0]) + gust / DRAG * np.sqrt(STEP) * np.cumsum(
        rng.standard_normal((steps, 3)) * (1, 1, 0), 0
    )
    rises = climb * np.cos(0.9 * time)
    tilt, accel = np.empty((steps, 2)), np.empty((steps, 3))
    for t in range(steps):
        if t > 0:
            attitude = attitude * turns[t - 1]
        axes = attitude.as_matrix()
        flow = axes.T @ (velocity - air[t])
        thrust = GRAVITY
        for _ in range(5):  # drag takes part in what carries the vehicle, and goes with thrust
            slowed = DRAG * np.sqrt(thrust / GRAVITY) + FRAME * np.linalg.norm(flow)
            thrust = (GRAVITY + rises[t] + slowed * axes[2, :2] @ flow[:2]) / axes[2, 2]
        accel[t] = [*(-slowed * flow[:2]), thrust]
        velocity = velocity + STEP * (axes @ accel[t] - [0, 0, GRAVITY])
        tilt[t] = -axes[1, 2], axes[0, 2]
    rates[:, :2] += bias
    accel[:, :2] += accel_bias
    return rates, accel, heading, tilt


def test_most_of_a_tilt_at_the_start_is_found_in_a_second_in_nine_of_ten_winds():
    rng, found_most = np.random.default_rng(5), []
    for seed in range(100):
        start, wind = rng.uniform(-0.3, 0.3, 2), rng.uniform(-10, 10, 2)
        gyro, accel, heading, tilt = flight(200, seed, start, wind=wind)
        kept, _ = found(gyro, accel, heading, align_s=1.0)
        off = np.abs(tilt_of(kept) - tilt).max(1)
        found_most.append(off[-1] < 0.03 + 0.25 * np.linalg.norm(start))
    assert np.mean(found_most) >= 0.9


@settings(deadline=None)  # the first example waits for the compiler
@given(st.integers(0, 99), st.floats(-0.08, 0.08), st.floats(-0.08, 0.08), st.floats(-1, 1))
def test_a_gyroscopes_bias_is_found_in_calm_flight_within_seconds(seed, x, y, yaw):
    gyro, accel, heading, _ = flight(2400, seed, (0.1, -0.1), (x, y), yaw=yaw, roll=0.15)
    kept, _ = found(gyro, accel, heading, accel_spread=0.0)
    off = np.abs(kept[:, BIAS : BIAS + 2] - [x, y]).max(1)
    assert off[1200:].max() < np.radians(2.5)
    assert off[2399] < np.radians(1.7)


def test_a_gyroscopes_bias_is_found_in_fast_flight_too():
    """Up to 45° and 20 m/s, where the filter's guess that a vehicle stays about where it is is wrong."""
    rng, late, last = np.random.default_rng(1), [], []
    for seed in range(60):
        bias = rng.uniform(-0.08, 0.08, 2)
        gyro, accel, heading, _ = flight(2400, seed, (0.1, -0.1), bias, yaw=rng.uniform(-1, 1))
        kept, _ = found(gyro, accel, heading, accel_spread=0.0)
        off = np.abs(kept[:, BIAS : BIAS + 2] - bias).max(1)
        late.append(off[1200:].max())
        last.append(off[2399])
    assert np.quantile(late, 0.95) < np.radians(2.5)
    assert np.quantile(last, 0.95) < np.radians(1.7)


@pytest.mark.parametrize(("told", "most"), [(False, (1.2, 2.2)), (True, (1.3, 1.4))])
def test_both_biases_are_not_much_further_off_than_it_says(told, most):
    """Adrift in winds of 5 m/s of each axis, which an unknown lean is not told from at once."""
    rng, squares = np.random.default_rng(0), []
    for seed in range(60):
        bias, accel_bias = rng.normal(0, BIAS_SPREAD / 2, 2), rng.normal(0, ACCEL_SPREAD, 2)
        start, wind, yaw = rng.normal(0, 0.1, 2), rng.normal(0, 5, 2), rng.uniform(-1, 1)
        gyro, accel, heading, tilt = flight(2000, seed, start, bias, wind, yaw, 0.1, accel_bias)
        kept, _ = found(gyro, accel, heading, told_tilt=tilt[0] if told else None, align_s=1.0)
        errors = kept[400::400, BIAS : ACCEL_BIAS + 2].reshape(-1, 2, 2) - np.stack([bias, accel_bias])
        squares.append(np.sum(errors**2, -1) / (2 * variances(kept[400::400])[:, 2:4]))
    deviations = np.sqrt(np.mean(squares, 0))
    assert (deviations > 0.45).all()
    assert (deviations < most).all()


def test_a_start_that_is_told_tells_the_accelerometers_bias_in_any_steady_wind():
    rng, left = np.random.default_rng(1), []
    for seed in range(40):
        bias, wind = rng.uniform(-0.4, 0.4, 2), rng.uniform(-10, 10, 2)
        gyro, accel, heading, tilt = flight(
            4000, seed, (0.1, -0.05), (0.005, -0.003), wind, rng.uniform(-1, 1), accel_bias=bias
        )
        kept, _ = found(gyro, accel, heading, told_tilt=tilt[0])
        left.append(np.linalg.norm(kept[-1, ACCEL_BIAS:][:2] - bias) / np.linalg.norm(bias))
    assert np.median(left) < 0.25
    assert np.quantile(left, 0.9) < 0.6


def test_a_vehicle_told_to_start_level_is_at_rest_so_that_a_wind_is_known_to_blow_it_away():
    gyro, accel, heading, tilt = flight(200, wind=(8.0, -4.0), roll=0.0)
    speed = STEP * np.sum(accel[1:, :2], 0)  # level, so that nothing else drives it
    assert np.linalg.norm(speed) > 1.0
    kept, _ = found(gyro, accel, heading, told_tilt=tilt[0], accel_spread=0.0)
    np.testing.assert_allclose(kept[-1, STATE + 8 : SPREAD], speed, rtol=0.05)
    kept, _ = found(gyro, accel, heading, accel_spread=0.0)  # not told, it may have moved against the wind
    assert (np.abs(kept[-1, STATE + 8 : SPREAD]) < 0.9 * np.abs(speed)).all()


def test_it_is_filterpys_kalman_filter_of_both_axes():
    """Ten real states: force, lean, biases and speed, x and y each; told, at rest, in flight, in a gust."""
    start = (0.2, -0.1)
    gyro, accel, heading, _ = flight(800, 3, start, (0.03, -0.05), (3.0, 1.0), 0.7, 0.2, (0.1, -0.2), 0.5)
    rest = np.array([[0.03, -0.05, 0.0]]), np.array([[1.0, 0.9, GRAVITY]])
    gyro, accel = (
        np.concatenate([np.repeat(a, 400, 0), b]) for a, b in zip(rest, (gyro, accel), strict=True)
    )
    accel[600:, 0] += 2.0
    accel[900:1000, 1] += np.tile([1.0, -1.0], 50)
    heading = np.concatenate([np.zeros(400), heading])
    kept, _ = found(gyro, accel, heading, told_tilt=start)
    assert (kept[:400, 2] >= REST_S).any()
    noise = 0.01**2 / STEP
    theirs = KalmanFilter(dim_x=10, dim_z=2)
    theirs.x[2:4, 0] = start[1], -start[0]  # the heading is 0
    at_first = np.diag(np.repeat([noise**0.5, TOLD_SD, BIAS_SPREAD, ACCEL_SPREAD, TOLD_SPEED], 2) ** 2)
    one = np.eye(2)
    at_first[:2, :2] += ACCEL_SPREAD**2 * one
    at_first[:2, 6:8] = at_first[6:8, :2] = -(ACCEL_SPREAD**2) * one
    gust, speed, missed, sudden = BREEZE**2, SPEED_SD**2, np.zeros(2), 0
    white, before, shaken = 0.0, None, 0
    lift, climb, rising, twisted = accel[0, 2], 0.0, 0.0, 0.0
    turns, summed, lowered, jumps = 0.0, np.zeros(2), 0.0, 0
    pushes, corrected, due, falls = 0.0, np.zeros(2), 0.0, 0
    for t in range(1200):
        axes = Rotation.from_rotvec([0, 0, heading[t] + twisted]).as_matrix()  # level ones, from the body's
        f, lean, bias, _, _ = theirs.x[:, 0].reshape(5, 2)
        rate = axes @ [*((gyro[t, :2] + gyro[max(t - 1, 0), :2]) / 2 - bias), 0.0]
        first = leaning([-lean[1], lean[0]])
        lean = lean + STEP / 2 * first.apply(np.cross(rate, [0, 0, 1]))[:2]
        body = leaning([-lean[1], lean[0]])
        upright = body.as_matrix()[2, 2]
        leant = STEP * body.apply(np.cross(rate, [0, 0, 1]))[:2]
        twisted += np.arctan(np.cross([*lean, 0], [*leant, 0])[2] / (1 + upright))
        mean_thrust = (accel[t, 2] + accel[max(t - 1, 0), 2]) / 2
        lift += (mean_thrust - lift) * STEP / THRUST_S
        air = (np.sqrt(1 + 4 * FRAME / DRAG**2 * np.linalg.norm(f)) - 1) / 2  # the frame's over the rotors'
        slowed = (np.sqrt(lift / GRAVITY) + air) / (1 + air)
        force = slowed * body.apply([*f, -DRAG * climb], inverse=True)[:2]
        rise = (body.apply([*force, mean_thrust]) - [0, 0, GRAVITY])[2]
        rising += (rise - rising) * STEP / min(CLIMB_FROM_S + (t + 1) * STEP, CLIMBS_S)
        climb += STEP * (rise - rising - climb / CLIMB_S)
        thrust = mean_thrust - rising / upright
        faster = body.apply([*force, thrust])[:2]
        pushes += (faster @ faster - pushes) * STEP / min(EXPECTED_S + (t + 1) * STEP, TURNS_S)
        onto = np.outer(f, f) / max(f @ f, 1e-18)
        change = -DRAG * STEP * ((1 + air) * one + air * onto) @ faster
        moved = np.concatenate([change, leant, np.zeros(4), STEP * faster])

        share = (1 + upright) / 2
        turn = STEP * share * axes[:2, :2] @ [[0, -1], [1, 0]]  # times i r
        slope, of_force = DRAG * STEP * (1 + 1.5 * air), slowed * share**2
        F = np.eye(10)
        F[0:2, 0:2], F[0:2, 2:4] = (1 - slope * of_force) * one, -slope * thrust * one
        F[2:4, 4:6] = turn
        F[8:, 0:2], F[8:, 2:4] = STEP * of_force * one, STEP * thrust * one
        at_once = max(missed @ missed - SUDDEN * STEP * max(white, noise) / SUDDEN_S, 0.0) / SUDDEN_S
        sudden += at_once > gust
        if t == 0:
            lies = np.sum((theirs.x[2:4, 0] + leant) ** 2) / LEANT_S**2
            at_first[8:, 8:] += lies * (LEANT_S**2 * GRAVITY) ** 2 * one
            believed = 1 / (1 + (TOLD_TURN**2 + lies + TURN_NOISE**2 / STEP) / BIAS_SPREAD**2)
            at_first[4:6, 4:6] *= 1 - believed
            bias = believed * gyro[0, :2]
            theirs.x[4:6, 0] = bias
        turned_by = np.sum((gyro[t, :2] - bias) ** 2)
        turns += (turned_by - turns) * STEP / min(EXPECTED_S + (t + 1) * STEP, TURNS_S)
        turning = TURN_NOISE**2 + TURN_ERROR**2 * turns
        blows = max(gust, at_once) + (DRAG_ERROR * DRAG) ** 2 * pushes
        walks = np.repeat([blows, turning, BIAS_WALK**2, ACCEL_BIAS_WALK**2, 0.0], 2) * STEP
        state = theirs.x + moved[:, None]
        if t == 0:
            state[:2, 0], state[8:] = accel[0, :2] / slowed, 0.0
            breath = BREATH**2 + np.sum(state[:2] ** 2) / 2
            theirs.P, F = at_first, np.eye(10)
        theirs.predict(F=F, Q=np.diag(walks))
        theirs.x, force_before, spread_before = state, theirs.P[0, 0], theirs.P[4, 4]
        turned = axes[:2, :2]
        H = np.hstack([slowed * share * one, np.zeros((2, 4)), turned, np.zeros((2, 2))])
        f, lean, _, accel_bias, _ = state[:, 0].reshape(5, 2)
        along = f - lean * (f @ lean) / (1 + upright) + DRAG * climb * lean
        off = turned @ (accel[t, :2] - accel_bias) - slowed * along
        change = off - before if t > 0 else np.zeros(2)
        white, before = white + STEP / NOISE_S * (change @ change / 4 - white), off
        shaken += white > noise
        theirs.update(H @ state + off[:, None], R=(max(white, noise) + MODEL**2 * pushes / STEP) * one, H=H)
        if (t + 1) * STEP > GAUGE_FROM_S:
            corrected += theirs.x[:2, 0] - f - corrected * STEP / CORRECTED_S
            due += force_before - theirs.P[0, 0] - 2 * due * STEP / CORRECTED_S
            beyond = GAUGE * (corrected @ corrected - 2 * ENOUGH * due) / CORRECTED_S
            memory = min(BREEZE_S + (t + 1) * STEP, GUSTS_S)
            falls += beyond < 0 and memory < FALL_S
            memory = max(memory, FALL_S) if beyond < 0 else memory
            gust = max(gust + beyond * STEP / memory, CALM**2)
        missed += STEP / SUDDEN_S * (off - missed)
        slow = max(speed, SPEED_MIN**2) * SPEED_S * (1 + LASTS_MORE * speed / SPEED_SD**2) / STEP
        theirs.update(np.zeros((2, 1)), R=slow * one, H=np.eye(10)[8:])
        speed += STEP / min(EXPECTED_S + (t + 1) * STEP, SPEEDS_S) * (np.mean(theirs.x[8:] ** 2) - speed)
        slow = max(breath, BREATH_MIN**2) * BREATH_S * (1 + LASTS_MORE * breath / BREATH**2) / STEP
        theirs.update(np.zeros((2, 1)), R=slow * one, H=np.eye(10)[:2])
        breath += STEP / min(EXPECTED_S + (t + 1) * STEP, AIRS_S) * (np.mean(theirs.x[:2] ** 2) - breath)
        summed += theirs.x[4:6, 0] - bias - summed * STEP / JUMP_S
        lowered += spread_before - theirs.P[4, 4] - 2 * lowered * STEP / JUMP_S
        beyond = max(summed @ summed / 2 - JUMP * lowered, 0.0)
        theirs.P[4:6, 4:6] += JUMP_GAIN * beyond * STEP / JUMP_S * one
        jumps += beyond > 0
        if kept[t, 2] >= REST_S:
            theirs.update(gyro[t, :2, None], R=REST_NOISE**2 / STEP * one, H=np.eye(10)[4:6])
        theirs.x[4:6] *= min(1.0, BIAS_MAX / max(np.linalg.norm(theirs.x[4:6]), 1e-9))
        np.testing.assert_allclose(kept[t, STATE:SPREAD], np.ravel(theirs.x), rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(np.repeat(variances(kept[t]), 2), np.diag(theirs.P), rtol=1e-6)
        assert kept[t, SPEED] == pytest.approx(speed, rel=1e-6)
        assert kept[t, AIR] == pytest.approx(breath, rel=1e-6)
        assert kept[t, CLIMB] == pytest.approx(climb, rel=1e-6, abs=1e-9)
        assert kept[t, GUST] == pytest.approx(gust, rel=1e-6)
    assert 10 < sudden < 1000
    assert 10 < shaken < 1000
    assert 10 < jumps < 1000
    assert 10 < falls < 1000


def test_a_gyroscopes_bias_about_z_is_found_where_the_vehicle_does_not_yaw_on_and_on():
    rng = np.random.default_rng(0)
    for bias in (-0.05, 0.01, 0.03):
        gyro, accel, heading, _ = flight(8000, 1)
        wobble = np.diff(0.02 * np.sin(np.linspace(0, 60, 8001)), prepend=0)[1:] / STEP
        gyro[:, 2] = bias + wobble + 0.01 * rng.standard_normal(8000)
        kept, _ = found(gyro, accel, heading)
        assert abs(kept[-1, YAW_BIAS] - bias) < 0.1 * abs(bias) + 0.002
    gyro[:, 2] = 1.0
    kept, _ = found(gyro, accel, heading)
    assert np.abs(kept[:, YAW_BIAS]).max() < 0.02


def test_a_heading_that_drifts_is_no_bias_of_the_accelerometer():
    """A hover in a steady wind, and a gyroscope that is off about z by half a degree a second."""
    lean, bias = 0.16, 0.0087
    gyro = np.tile([0.0, 0.0, bias], (20000, 1))
    accel = np.tile([-GRAVITY * lean, 0.0, GRAVITY], (20000, 1))
    held = np.zeros((1, HELD))
    held[0, ALIGNMENT:] = known_to(np.array([[0.0, np.arcsin(lean)]]))[0, ALIGNMENT:]
    shaken = gyro + 0.02 * np.random.default_rng(0).standard_normal(gyro.shape)  # a rest it is not
    scaled_inputs(shipped_network("att-snn")[0].inputs, 200.0, shaken[None], accel[None], held)
    assert np.abs(held[0, ALIGNMENT + ACCEL_BIAS :][:2]).max() < 0.05
    assert abs(np.arctan2(held[0, HEADING + 1], held[0, HEADING])) < 0.06


def test_the_heading_is_turned_back_by_what_a_bias_has_turned_it_as_filterpy_finds_it():
    """Two states: what the bias has turned the heading by, and the bias, that a rate is where none yaws."""
    rng, inputs = np.random.default_rng(3), INPUTS.model_copy(update={"bias_sd": 0.01})
    gyro = np.tile([0.0, 0.0, 0.015], (2000, 1)) + 0.004 * rng.standard_normal((2000, 3))
    gyro[400:500, 2] += 0.3
    accel = np.tile([0.3, -0.1, GRAVITY], (2000, 1)) + 0.05 * rng.standard_normal((2000, 3))
    theirs = KalmanFilter(dim_x=2, dim_z=1)
    theirs.F, theirs.H = np.array([[1.0, STEP], [0.0, 1.0]]), np.array([[0.0, 1.0]])
    theirs.P, theirs.Q = np.diag([0.0, 0.01**2]), np.diag([0.0, BIAS_WALK**2 * STEP])
    held, turned = np.zeros((1, HELD)), 0.0
    square = YAW_RATE**2 + gyro[0, 2] ** 2
    for t in range(2000):
        _, heading = scaled_inputs(inputs, 200.0, gyro[None, t : t + 1], accel[None, t : t + 1], held)
        theirs.predict()
        turned += gyro[t, 2] * STEP
        angle = np.arctan2(heading[0, 0, 1], heading[0, 0, 0])
        assert angle == pytest.approx(turned - theirs.x[0, 0], abs=1e-5)
        theirs.update(gyro[t, 2], R=max(square, YAW_RATE_MIN**2) * YAW_S * (1 + square / YAW_RATE**2) / STEP)
        assert held[0, ALIGNMENT + YAW_BIAS] == pytest.approx(theirs.x[1, 0], abs=1e-6)
        square = held[0, ALIGNMENT + YAW_BIAS + 2]
    assert abs(angle - 0.3 * 0.5) < 0.08  # what it has yawed; the bias alone makes that 0.15 more


def test_at_rest_bias_and_tilt_are_found_whatever_the_drag():
    bias = np.radians([4.1, -1.2, -1.6])
    gyro, accel = np.tile(bias, (1600, 1)), np.tile([-GRAVITY * 0.2, GRAVITY * 0.1, GRAVITY], (1600, 1))
    for drag in (0.2, 0.4):
        kept, _ = found(gyro, accel, drag=drag, align_s=1.0)
        np.testing.assert_allclose(kept[300:, BIAS : BIAS + 2], np.tile(bias[:2], (1300, 1)), atol=0.004)
        np.testing.assert_allclose(tilt_of(kept)[-1], [0.1, 0.2], atol=0.02)


def test_a_hover_is_no_rest():
    gyro, accel, heading, _ = flight(2000, 1)
    kept, _ = found(0.1 * gyro, accel, heading)
    assert (kept[:, 2] < REST_S).all()


def test_a_bias_that_has_changed_is_learnt_anew():
    gyro, accel, heading, _ = flight(30000, 2, gust=0.1)
    gyro[10000:, 0] += 0.05
    kept, _ = found(gyro, accel, heading)
    assert abs(kept[9999, BIAS]) < 0.005
    assert abs(kept[-1, BIAS] - 0.05) < 0.01
    assert kept[-1, GUST] < 2 * kept[9999, GUST]  # and is no gust


def test_a_bias_that_jumps_is_found_again_within_seconds():
    left = []
    for seed in range(16):
        jump = np.radians(4.0) * np.array([np.cos(seed), np.sin(seed)])
        gyro, accel, heading, tilt = flight(4000, seed, roll=0.15)
        gyro[2000:, :2] += jump
        kept, _ = found(gyro, accel, heading, told_tilt=tilt[0])
        left.append(np.linalg.norm(kept[-1, BIAS : BIAS + 2] - jump) / np.linalg.norm(jump))
        assert np.abs(tilt_of(kept) - tilt).max() < np.radians(20)
    assert np.median(left) < 0.05
    assert max(left) < 0.5


@pytest.mark.parametrize("gust", [0.4, 0.8])
def test_the_random_walk_of_the_force_is_learnt_and_not_taken_for_less(gust):
    walks = [found(*flight(8000, seed, gust=gust)[:3])[0][2000:, GUST] for seed in range(6)]
    assert gust < np.sqrt(np.mean(walks)) < 2 * gust


@settings(deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1e12, 1e12)] * 6), min_size=1, max_size=60),
    st.floats(1e-3, 10),
    st.floats(1e-3, 10),
)
def test_any_readings_leave_what_is_possible(readings, drag, noise):
    readings = np.array(readings)
    kept, told = found(readings[:, :3], readings[:, 3:], noise=noise, drag=drag)
    assert np.isfinite(kept).all()
    assert np.isfinite(told).all()
    assert np.abs(kept[:, BIAS : BIAS + 2]).max() <= BIAS_MAX
    assert np.abs(kept[:, LEAN : LEAN + 2]).max() <= LEAN_MAX
    assert np.abs(kept[:, ACCEL_BIAS : ACCEL_BIAS + 2]).max() <= ACCEL_BIAS_MAX
    assert (variances(kept) > 0).all()


def test_a_bias_that_is_known_to_be_none_stays_none():
    gyro, accel, _, _ = flight(4000, 2, bias=(0.05, -0.03))
    held = np.zeros((1, HELD))
    scaled_inputs(INPUTS, 200.0, gyro[None], accel[None], held)
    np.testing.assert_array_equal(held[0, ALIGNMENT + BIAS :][:4], 0.0)


def test_one_bad_reading_does_no_lasting_harm():
    gyro, accel, heading, _ = flight(3000, 3, (0.2, 0.1), gust=0.1)
    clean, _ = found(gyro, accel, heading)
    accel[1500, :2] = 1e6, -1e6
    kept, _ = found(gyro, accel, heading)
    np.testing.assert_allclose(tilt_of(kept)[-1], tilt_of(clean)[-1], atol=0.01)
    np.testing.assert_allclose(kept[-1, BIAS : BIAS + 2], 0.0, atol=0.01)


def test_what_a_bias_has_done_is_taken_back_as_far_as_it_is_remembered():
    gyro, accel, heading, _ = flight(2000, 4, bias=(0.07, -0.04), yaw=0.8)
    kept, told = found(gyro, accel, heading)
    rate = gyro[:, :2] - kept[:, BIAS : BIAS + 2] + told / STEP
    turn = np.exp(1j * heading)
    mine = whole = effect = 0.0
    for t in range(2000):
        left = 1 - STEP / REMEMBERED_S
        mine = left * mine + STEP * turn[t] * complex(*rate[t])
        whole = left * whole + STEP * turn[t] * complex(*gyro[t, :2])
        effect = left * effect + STEP * turn[t]
        # as if the bias that is now believed had been known all along
        assert mine == pytest.approx(whole - complex(*kept[t, BIAS : BIAS + 2]) * effect, abs=2e-4)


INPUTS = InputScaling(align_s=0.6, align_drag=DRAG, align_noise=1e-4, yaw_free=True)


@pytest.mark.parametrize("yaw", [0.0, 1.5])
def test_the_network_is_told_by_a_turn_from_level(yaw):
    gyro, accel, _, tilt = flight(200, 5, (0.15, -0.25), yaw=yaw)
    x, _ = scaled_inputs(INPUTS, 200.0, gyro[None], accel[None])
    integral = STEP * np.cumsum(x[0, :, :2], axis=0) * INPUTS.gyro
    np.testing.assert_allclose(integral[120:] - tilt[120:], 0.0, atol=0.07)


def test_samples_that_are_missing_leave_a_gap_in_time_alone():
    gyro, accel, _, tilt = flight(200, 6, (0.15, -0.25))
    accel[20:40] = np.nan
    x, _ = scaled_inputs(INPUTS, 200.0, gyro[None], accel[None])
    integral = STEP * np.cumsum(x[0, :, :2], axis=0) * INPUTS.gyro
    np.testing.assert_allclose(integral[120:] - tilt[120:], 0.0, atol=0.07)


def test_it_ends_in_time_and_is_left_out_where_the_attitude_is_known():
    gyro, accel, _, _ = flight(200, 5, (0.15, -0.25))
    x, _ = scaled_inputs(INPUTS, 200.0, gyro[None], accel[None])
    plain, _ = scaled_inputs(INPUTS.model_copy(update={"align_s": 0.0}), 200.0, gyro[None], accel[None])
    differs = np.abs(x - plain)[0, :, :2].max(1) * INPUT_ONE > 0.5
    assert differs[2:100].any()
    assert not differs[120:].any()
    held = np.zeros((1, HELD))
    held[:, ALIGNMENT] = np.inf
    np.testing.assert_array_equal(scaled_inputs(INPUTS, 200.0, gyro[None], accel[None], held)[0], plain)


def test_a_start_that_is_told_is_known_to_the_filter_too():
    config, tensors = shipped_network("att-snn")
    est = NetworkEstimator(Spiking(config, tensors), 200.0)
    gyro, accel, _, tilt = flight(200, 7, (0.15, -0.25))
    est.reset(1, roll_pitch=tilt[:1])
    kept = est._states[0][0, ALIGNMENT:]
    assert kept[0] == np.inf
    np.testing.assert_allclose(tilt_of(kept), tilt[0], atol=0.02)
    est.sequence(gyro[None], accel[None])
    np.testing.assert_allclose(tilt_of(est._states[0][0, ALIGNMENT:]), tilt[-1], atol=0.03)


@pytest.mark.parametrize("told", [np.nan, np.inf])
def test_an_attitude_that_is_no_number_is_refused(told):
    est = NetworkEstimator(Spiking(*shipped_network("att-snn")), 200.0)
    with pytest.raises(ValueError, match="not finite"):
        est.reset(1, roll_pitch=[[told, 0.0]])


def test_the_lean_that_is_fed_is_that_of_the_filter_alone_and_near_the_truth():
    gyro, accel, _, tilt = flight(2000, 8, (0.1, -0.2), wind=(6.0, -3.0), yaw=0.5, climb=0.5)
    start = np.array([[np.arcsin(0.1 / np.sqrt(1 - 0.2**2)), np.arcsin(-0.2)]])
    found_alone = lean_found(INPUTS, 200.0, gyro[None], accel[None], start)[0]
    inclination = np.arccos(np.cos(found_alone[:, 0]) * np.cos(found_alone[:, 1]))
    np.testing.assert_allclose(inclination, np.arcsin(np.linalg.norm(tilt, axis=1)), atol=0.02)
    assert np.ptp(tilt) > 0.5
    x, heading = scaled_inputs(
        INPUTS.model_copy(update={"lean_fed": True}), 200.0, gyro[None], accel[None], known_to(start)
    )
    about_y, about_x = (-x[..., 3:5] * INPUTS.accel[:2] / GRAVITY * (1, -1))[0].T
    turned = tilt_of_roll_pitch(found_alone[None], heading)[0]
    np.testing.assert_allclose(np.stack([about_x, about_y], -1), turned, atol=2e-3)


def test_rates_that_are_fed_sum_up_to_the_lean_over_any_gap():
    gyro, accel, _, _ = flight(2000, 8, wind=(6.0, -3.0), yaw=0.5)
    gyro[700:720], accel[700:720], accel[1300:1310] = np.nan, 0.0, 0.0
    inputs = INPUTS.model_copy(update={"lean_fed": True})
    x, _ = scaled_inputs(inputs, 200.0, gyro[None], accel[None], known_to(np.zeros((1, 2))))
    summed = STEP * inputs.gyro * np.cumsum(x[0, :, :2], 0)
    about_y, about_x = (-x[..., 3:5] * inputs.accel[:2] / GRAVITY * (1, -1))[0].T
    off = np.abs(summed - np.stack([about_x, about_y], -1)).max(1)
    found = np.isfinite(gyro[:, 0]) & (accel[:, 2] > 0)
    assert off[found].max() < STEP * inputs.gyro / INPUT_ONE + 2 / INPUT_ONE / GRAVITY
    assert off[~found].max() > 0.01


def test_what_makes_up_for_a_gap_does_not_go_on_in_the_next():
    """Four of five samples are lost: what is fed in between goes on as the body turned."""
    gyro, accel, _, tilt = flight(4000, 8, roll=0.15)
    lost = np.random.default_rng(0).random(4000) < 0.8
    gyro[lost], accel[lost] = np.nan, np.nan
    inputs = INPUTS.model_copy(update={"lean_fed": True})
    x, _ = scaled_inputs(inputs, 200.0, gyro[None], accel[None], known_to(np.zeros((1, 2))))
    fed = np.sin(STEP * inputs.gyro * np.cumsum(x[0, :, :2], 0))
    assert np.sqrt(np.mean((fed - tilt) ** 2)) < np.radians(1.5)


def test_the_force_is_fed_freed_of_its_bias_where_the_lean_is_not():
    gyro, accel, _, _ = flight(400, 9, accel_bias=(0.2, -0.1))
    inputs = INPUTS.model_copy(update={"accel_bias_sd": 0.2, "yaw_free": False})
    held = known_to(np.zeros((1, 2)))
    x, _ = scaled_inputs(inputs, 200.0, gyro[None], accel[None], held)
    fed = x[0, -1, 3:5] * np.array(inputs.accel[:2])
    np.testing.assert_allclose(fed, accel[-1, :2] - held[0, ALIGNMENT + ACCEL_BIAS :][:2], atol=2e-3)


def test_a_lean_that_is_fed_is_looked_for_where_no_bias_is():
    gyro, accel, _, tilt = flight(400, 10, (0.1, -0.2))
    start = np.array([[np.arcsin(0.1 / np.sqrt(1 - 0.2**2)), np.arcsin(-0.2)]])
    alone = lean_found(InputScaling(align_drag=DRAG), 200.0, gyro[None], accel[None], start)[0, -1]
    np.testing.assert_allclose(np.sin(alone[1]), tilt[-1, 1], atol=0.02)


@pytest.mark.parametrize(
    ("gyro", "accel", "start", "match"),
    [
        ((2, 9, 3), (2, 8, 3), (2, 2), "one shape"),
        ((9, 3), (9, 3), (1, 2), "one shape"),
        ((2, 9, 3), (2, 9, 3), (1, 2), "shape"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(gyro, accel, start, match):
    with pytest.raises(ValueError, match=match):
        lean_found(INPUTS, 200.0, np.zeros(gyro), np.ones(accel), np.zeros(start))


def test_a_start_of_the_filter_alone_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="not finite"):
        lean_found(INPUTS, 200.0, np.zeros((1, 9, 3)), np.ones((1, 9, 3)), [[np.nan, 0.0]])
