"""Loop design: controller gains from phase margins, with the `control` package.

Every loop is closed around the one inside it, and its gain is the one that gives the required phase margin:

    rate      L = (k_rate + k_rate_i / s) / s · M(s) · e^{−s T/2}
    attitude  L = k_att · T_rate(s) / s · e^{−s T_est}
    velocity  L = (k_vel + k_vel_i / s) · T_att(s) / s
    position  L = k_pos · T_vel(s) / s

M(s) = 1 / (τ s + 1) is the rotor lag, T the sample period (a zero-order hold delays by half a sample), T_est
the delay of the estimator, and T_x(s) the closed inner loop. Delays are approximated by 3rd-order Padé
functions.
"""

from collections.abc import Mapping
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
"""Corner frequency of an integral action divided by the loop's crossover frequency, which is about the
proportional gain."""
YAW_RATE = 0.4
"""Yaw-rate gain divided by roll-rate gain. Yaw torque is weak, so a faster loop would only saturate the
rotors."""


class Margins(NamedTuple):
    """Stability margins of one loop."""

    crossover: float  #: gain crossover [rad/s]
    phase_deg: float  #: phase margin [deg]
    gain_db: float  #: gain margin [dB]
    delay_ms: float  #: further delay until it oscillates [ms]


class Blocks(NamedTuple):
    """Transfer functions that the loops are made of."""

    actuator: TransferFunction  #: commanded angular acceleration to body rate
    estimator: TransferFunction  #: true attitude to estimate
    integrator: TransferFunction  #: 1 / s


def blocks(vehicle: Vehicle, rate_hz: float, estimator_delay: float) -> Blocks:
    """Return the transfer functions of actuator and estimator."""
    integrator = TransferFunction([1.0], [1.0, 0.0])
    lag = TransferFunction([1.0], [0.5 * (vehicle.motor.tau_up + vehicle.motor.tau_down), 1.0])
    half_a_sample, estimator = (
        TransferFunction(*control.pade(delay, 3)) for delay in (0.5 / rate_hz, estimator_delay)
    )
    return Blocks(lag * half_a_sample * integrator, estimator, integrator)


def open_loop(b: Blocks, name: str, gains: Mapping[str, float]) -> TransferFunction:
    """Return an open loop: "rate", "yaw_rate", "attitude", "yaw", "velocity" or "position".

    Yaw does not pass through the estimator. The velocity loop has units of m/s² of horizontal thrust.

    Args:
        b: Transfer functions of actuator and estimator.
        name: Name of the loop.
        gains: Proportional gains of this loop and of the loops inside it, by name.
    """
    k = gains[name]
    if name in ("rate", "yaw_rate"):
        return (k + INTEGRAL * k**2 * b.integrator) * b.actuator
    if name == "position":
        return k * control.feedback(open_loop(b, "velocity", gains)) * b.integrator
    inner = "yaw_rate" if name == "yaw" else "rate"
    turn = k if name != "velocity" else gains["attitude"]
    forward = turn * control.feedback(open_loop(b, inner, gains)) * b.integrator
    if name == "velocity":
        tilted = control.feedback(forward, b.estimator)
        return (k + INTEGRAL * k**2 * b.integrator) * tilted * b.integrator
    return forward * b.estimator if name == "attitude" else forward


def design(vehicle: Vehicle, rate_hz: float = 200.0, estimator_delay: float = ESTIMATOR_DELAY) -> Gains:
    """Compute the gains that give every loop its phase margin (`PHASE_MARGIN_DEG`), innermost loop first.

    Raises:
        ValueError: The delay is too long to reach a phase margin.
    """
    b, k = blocks(vehicle, rate_hz, estimator_delay), {}
    for name in PHASE_MARGIN_DEG:
        k[name] = _gain_for(b, name, k)
        k["yaw_rate"] = YAW_RATE * k["rate"]
    integrals = {f"{name}_integral": INTEGRAL * k[name] ** 2 for name in ("rate", "yaw_rate", "velocity")}
    return Gains(**k, **integrals)


def loop_margins(
    vehicle: Vehicle, gains: Gains, rate_hz: float = 200.0, estimator_delay: float = ESTIMATOR_DELAY
) -> dict[str, Margins]:
    """Return the margins of every loop with the given gains and estimator delay."""
    b, k = blocks(vehicle, rate_hz, estimator_delay), gains.model_dump()
    found = {}
    for name in ("rate", "yaw_rate", "attitude", "yaw", "velocity", "position"):
        gain, phase, _, _, crossover, _ = control.stability_margins(open_loop(b, name, k))
        numbers = crossover, phase, 20 * np.log10(gain), 1e3 * np.radians(phase) / crossover
        found[name.replace("_", " ")] = Margins(*map(float, numbers))
    return found


def _gain_for(b: Blocks, name: str, inner: Mapping[str, float]) -> float:
    """Find the largest gain with the required phase margin by a downward scan and bisection."""
    phase_deg = PHASE_MARGIN_DEG[name]

    def excess(k: float) -> float:
        margin = control.stability_margins(open_loop(b, name, {**inner, name: k}))[1]
        return (float(margin) if np.isfinite(margin) else -180.0) - phase_deg

    grid = np.geomspace(200.0, 0.02, 80)
    above = next((i for i, k in enumerate(grid) if excess(k) > 0), 0)
    if above == 0:
        raise ValueError(
            f"no gain gives the {name} loop a phase margin of {phase_deg:g}°: its delays are too long"
        )
    return root_scalar(excess, bracket=(grid[above], grid[above - 1]), xtol=1e-9).root
