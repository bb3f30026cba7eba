"""Extended Kalman filter of the quaternion: gyroscope in the prediction, accelerometer in the correction.

The state is q, a random walk in quaternion space around the integrated gyroscope:

    q ← q ⊗ exp(½ ω dt),   F the matrix of that product,   P ← F P Fᵀ + ¼ N² dt I

The measurement is the direction of the specific force in body axes, predicted as h(q) = R(q)ᵀ (0, 0, 1), with
covariance σ² / dt I. Noise parameters are densities, so that the filter behaves equally at any sample rate. ω
is the mean of the last two samples. `packaged` contains the same filter with filterpy's classes.
"""

import numpy as np

from quadsim.rotation import normalize_core
from quadsim.runs.compiled import njit

from .driver import Array, CompiledFilter, Records
from .inline_math import direction_core, exp_core, multiply, put, roll_pitch_core
from .samples import run_vehicles

SIGMA_KNOWN = 0.01
"""Standard deviation of a known initial attitude [rad]."""
SIGMA_UNKNOWN = 0.5
"""Standard deviation of an unknown initial attitude, which is taken as level [rad]."""
NOTHING_KNOWN = 1e300
"""Variance of a missing measurement."""

RECORD = np.dtype(
    [
        ("quat", "f8", 4),
        ("covariance", "f8", (4, 4)),
        ("moved", "f8", (4, 4)),  # scratch: F P, the error estimated so far, and P hᵀ of a measurement
        ("error", "f8", 4),
        ("column", "f8", 4),
    ]
)


@njit
def dot(a, b):
    """Return the inner product of two tuples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@njit
def propagate(P, T, step, noise):
    """Compute P ← F P Fᵀ + noise I for a symmetric P, with F x = x ⊗ step; T is scratch space."""
    for i in range(4):
        put(T[i], multiply(P[i], step))
    for i in range(4):
        put(P[i], multiply(T[:, i], step))
        P[i, i] += noise


@njit(forceinline=True, error_model="numpy")
def correct(P, size, dx, column, total, residual):
    """Apply one scalar measurement with row h: update the error dx and the covariance P.

    Args:
        P: Covariance.
        size: Number of errors in the state; P may have further columns of zeros.
        dx: Estimated error.
        column: P hᵀ.
        total: h P hᵀ plus the variance of the measurement.
        residual: Measured minus expected value, minus h dx.
    """
    for a in range(size):
        gain = column[a] / total
        dx[a] += gain * residual
        for b in range(len(column)):
            P[a, b] -= gain * column[b]


@njit(inline="always")
def step(s, p, sample):
    """See `driver`.

    The noises of the measurement's axes are independent, so that correcting by one after the other equals
    correcting by all at once. A missing force has the variance of nothing known.
    """
    dt, P, dx, column = sample.dt, s.covariance, s.error, s.column
    gx, gy, gz = sample.mean_gyro
    ax, ay, az = sample.accel
    turn = exp_core(gx * dt, gy * dt, gz * dt)
    w, x, y, z = multiply(s.quat, turn)
    propagate(P, s.moved, turn, 0.25 * (p.gyro_noise * p.gyro_noise * dt + sample.unseen))
    variance = p.accel_noise * p.accel_noise / dt + (0.0 if sample.found else NOTHING_KNOWN)
    ax, ay, az = direction_core(ax, ay, az)
    residual = ax - 2.0 * (x * z - w * y), ay - 2.0 * (y * z + w * x), az - (w * w - x * x - y * y + z * z)
    rows = (-y, z, -w, x), (x, w, z, y), (w, -x, -y, z)
    dx[:] = 0.0
    for k in range(3):
        h = rows[k]
        for a in range(4):
            column[a] = 2.0 * dot(P[a], h)
        correct(P, 4, dx, column, 2.0 * dot(h, column) + variance, residual[k] - 2.0 * dot(h, dx))
    put(s.quat, normalize_core(w + dx[0], x + dx[1], y + dx[2], z + dx[3]))
    return roll_pitch_core(s.quat)


@njit(cache=True, nogil=True, error_model="numpy")
def run(states, samples, params, dt, gyro, accel, rotor_vel, out):
    """Process a sample or sequences; see `driver`."""
    run_vehicles(step, states, samples, params, dt, gyro, accel, rotor_vel, out)


class Ekf(CompiledFilter):
    """The filter of n vehicles."""

    record, run = RECORD, staticmethod(run)

    def begin(self, states: Records, quat: Array, known: bool) -> None:
        """Initialise attitude and variance."""
        states["quat"] = quat
        states["covariance"][:, range(4), range(4)] = 0.25 * (SIGMA_KNOWN if known else SIGMA_UNKNOWN) ** 2

    def tilt_covariance(self) -> Array:
        """Return the covariance of the error θ = 2 (δq ⊗ q*), world x and y, (n, 2, 2) [rad²]."""
        w, x, y, z = self.quat.T
        to_tilt = 2.0 * np.stack([-x, w, -z, y, -y, z, w, -x], axis=-1).reshape(-1, 2, 4)
        return to_tilt @ self.state["covariance"] @ np.swapaxes(to_tilt, 1, 2)
