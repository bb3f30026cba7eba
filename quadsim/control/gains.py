"""Loop design: controller gains from phase margins, with the `control` package.

Every loop is closed around the one inside it, and its gain is the one that gives the required phase margin:

    rate      L = (k_rate + k_rate_i / s) / s · M(s) · e^{−s T/2}
    attitude  L = k_att · T_rate(s) / s · e^{−s T_est}
    velocity  L = (k_vel + k_vel_i / s) · T_att(s) / s
    position  L = k_pos · T_vel(s) / s

with M(s) = 1 / (τ s + 1) the rotor lag, T the sample period (zero-order hold: half a sample), T_est the
estimator's delay, T_x(s) the closed inner loop. Delays are 3rd-order Padé approximations.
"""

from collections.abc import Callable
from typing import NamedTuple

import control
import numpy as np
from control import TransferFunction
from scipy.optimize import root_scalar

from ..vehicle import Gains, Vehicle

ESTIMATOR_DELAY = 0.015
"""From sample to estimate: three network steps at 200 Hz [s]."""
PHASE_MARGIN_DEG = {"rate": 60.0, "attitude": 60.0, "yaw": 70.0, "velocity": 60.0, "position": 70.0}
INTEGRAL = 0.1
"""Corner frequency of an integral action over the loop's crossover, which is about the proportional gain."""
YAW_RATE = 0.4
"""Yaw-rate gain over roll-rate gain: yaw torque is weak, and a fast loop would only saturate the rotors."""


class Margins(NamedTuple):
    """Robustness of one loop."""

    crossover: float  #: gain crossover [rad/s]
    phase_deg: float  #: phase margin [deg]
    gain_db: float  #: gain margin [dB]
    delay_ms: float  #: further delay until it oscillates [ms]


class Blocks(NamedTuple):
    """What the loops are made of."""

    actuator: TransferFunction  #: commanded angular acceleration to body rate
    estimator: TransferFunction  #: true attitude to estimate
    integrator: TransferFunction  #: 1 / s


def blocks(vehicle: Vehicle, rate_hz: float, estimator_delay: float) -> Blocks:
    """Actuator and estimator as transfer functions."""
    integrator = TransferFunction([1.0], [1.0, 0.0])
    lag = TransferFunction([1.0], [0.5 * (vehicle.motor.tau_up + vehicle.motor.tau_down), 1.0])
    return Blocks(lag * _delay(0.5 / rate_hz) * integrator, _delay(estimator_delay), integrator)


def rate_loop(b: Blocks, k: float) -> TransferFunction:
    """Open rate loop, PI on an integrator with rotor lag."""
    return (k + INTEGRAL * k**2 * b.integrator) * b.actuator


def attitude_loop(b: Blocks, k_rate: float, k: float, delayed: bool = True) -> TransferFunction:
    """Open attitude (or yaw) loop around the closed rate loop; yaw does not come from the estimator."""
    forward = k * control.feedback(rate_loop(b, k_rate)) * b.integrator
    return forward * b.estimator if delayed else forward


def velocity_loop(b: Blocks, k_rate: float, k_att: float, k: float) -> TransferFunction:
    """Open velocity loop around the closed attitude loop, per m/s² of thrust tilted."""
    forward = attitude_loop(b, k_rate, k_att, delayed=False)
    return (k + INTEGRAL * k**2 * b.integrator) * control.feedback(forward, b.estimator) * b.integrator


def position_loop(b: Blocks, k_rate: float, k_att: float, k_vel: float, k: float) -> TransferFunction:
    """Open position loop around the closed velocity loop."""
    return k * control.feedback(velocity_loop(b, k_rate, k_att, k_vel)) * b.integrator


def design(vehicle: Vehicle, rate_hz: float = 200.0, estimator_delay: float = ESTIMATOR_DELAY) -> Gains:
    """Gains that give every loop its phase margin (`PHASE_MARGIN_DEG`), from the inside out.

    Raises:
        ValueError: If the delay is too long for a margin to be reached.
    """
    b = blocks(vehicle, rate_hz, estimator_delay)
    want = PHASE_MARGIN_DEG
    k_rate = _gain_for(lambda k: rate_loop(b, k), want["rate"], "rate")
    k_yaw_rate = YAW_RATE * k_rate
    k_att = _gain_for(lambda k: attitude_loop(b, k_rate, k), want["attitude"], "attitude")
    k_yaw = _gain_for(lambda k: attitude_loop(b, k_yaw_rate, k, delayed=False), want["yaw"], "yaw")
    k_vel = _gain_for(lambda k: velocity_loop(b, k_rate, k_att, k), want["velocity"], "velocity")
    k_pos = _gain_for(lambda k: position_loop(b, k_rate, k_att, k_vel, k), want["position"], "position")
    return Gains(
        rate=k_rate,
        rate_integral=INTEGRAL * k_rate**2,
        yaw_rate=k_yaw_rate,
        yaw_rate_integral=INTEGRAL * k_yaw_rate**2,
        attitude=k_att,
        yaw=k_yaw,
        velocity=k_vel,
        velocity_integral=INTEGRAL * k_vel**2,
        position=k_pos,
    )


def loop_margins(
    vehicle: Vehicle, gains: Gains, rate_hz: float = 200.0, estimator_delay: float = ESTIMATOR_DELAY
) -> dict[str, Margins]:
    """Margins of every loop with the given gains, under a given estimator delay."""
    b = blocks(vehicle, rate_hz, estimator_delay)
    g = gains
    return {
        "rate": margins(rate_loop(b, g.rate)),
        "yaw rate": margins(rate_loop(b, g.yaw_rate)),
        "attitude": margins(attitude_loop(b, g.rate, g.attitude)),
        "yaw": margins(attitude_loop(b, g.yaw_rate, g.yaw, delayed=False)),
        "velocity": margins(velocity_loop(b, g.rate, g.attitude, g.velocity)),
        "position": margins(position_loop(b, g.rate, g.attitude, g.velocity, g.position)),
    }


def margins(loop: TransferFunction) -> Margins:
    """Margins of an open loop."""
    gain, phase, _, _, crossover, _ = control.stability_margins(loop)
    return Margins(
        float(crossover), float(phase), float(20 * np.log10(gain)), float(1e3 * np.radians(phase) / crossover)
    )


def _delay(seconds: float) -> TransferFunction:
    numerator, denominator = control.pade(seconds, 3) if seconds > 0 else ([1.0], [1.0])
    return TransferFunction(numerator, denominator)


def _gain_for(loop: Callable[[float], TransferFunction], phase_deg: float, name: str) -> float:
    """The largest gain with the required phase margin: scan down to where the loop has it, then bisect."""
    grid = np.geomspace(200.0, 0.02, 80)
    excess = [_phase_margin(loop(k)) - phase_deg for k in grid]
    above = next((i for i, e in enumerate(excess) if e > 0), None)
    if above is None or above == 0:
        raise ValueError(
            f"no gain gives the {name} loop a phase margin of {phase_deg:g}°: its delays are too long"
        )
    bracket = (grid[above], grid[above - 1])
    return root_scalar(lambda k: _phase_margin(loop(k)) - phase_deg, bracket=bracket, xtol=1e-9).root


def _phase_margin(loop: TransferFunction) -> float:
    phase = control.stability_margins(loop)[1]
    return float(phase) if np.isfinite(phase) else -180.0
