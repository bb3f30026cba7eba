"""The filter of the tilt and of both biases, and that of the heading, against filterpy's."""

import numpy as np
import pytest
from drag_flight import ACCEL_SPREAD, BIAS_SPREAD, DRAG, STEP, flight, found, leaning, variances
from filterpy.kalman import KalmanFilter
from scipy.spatial.transform import Rotation

from estimators.alignment import (
    ACCEL_BIAS_WALK,
    AIR,
    AIRS_S,
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
    LASTS_MORE,
    LEANT_S,
    MODEL,
    NOISE_S,
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
)
from estimators.encoder import ALIGNMENT, HELD, scaled_inputs
from estimators.weights_file import InputScaling
from quadsim.vehicle import GRAVITY

INPUTS = InputScaling(align_s=0.6, align_drag=DRAG, align_noise=1e-4, yaw_free=True)


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
