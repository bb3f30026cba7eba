"""A free rigid body, integrated by the same scheme as MuJoCo's RK4.

MuJoCo integrates a body with a free joint by a Runge–Kutta–Munthe-Kaas scheme (Munthe-Kaas 1998): velocity,
body rate and position by the classical fourth-order method, the attitude by the same method in the Lie
algebra, q = q₀ ⊗ exp(u), u' = dexp⁻¹(ω). `quadsim.plant` chooses between the two; tests compare them.
"""

import math

from ..rotation import rotate_core
from ..runs.compiled import njit
from ..vehicle import GRAVITY
from .rotors import angular_acceleration


@njit(cache=True)
def dexp_inverse(u, w):
    """Return the derivative of the rotation vector u of q = q₀ ⊗ exp(u) for a body rate w.

    The derivative is w + ½ u × w + (1 − ½θ cot ½θ)/θ² u × (u × w), θ = |u| (Iserles et al. 2000, eq. 2.46,
    right-trivialised).
    """
    x, y, z = u
    cx, cy, cz = y * w[2] - z * w[1], z * w[0] - x * w[2], x * w[1] - y * w[0]
    square = x * x + y * y + z * z
    if square < 1e-4:  # the next term of the series is below 1e-17
        c = 1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30240.0 + square / 1209600.0))
    else:
        half = 0.5 * math.sqrt(square)
        c = (1.0 - half / math.tan(half)) / square
    return (
        w[0] + 0.5 * cx + c * (y * cz - z * cy),
        w[1] + 0.5 * cy + c * (z * cx - x * cz),
        w[2] + 0.5 * cz + c * (x * cy - y * cx),
    )


@njit(cache=True)
def unit(q):
    """Normalise a quaternion as MuJoCo does: zero becomes the identity, and a length of 1 is kept."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if norm < 1e-15:
        return 1.0, 0.0, 0.0, 0.0
    if abs(norm - 1.0) > 1e-15:
        return w / norm, x / norm, y / norm, z / norm
    return w, x, y, z


@njit(cache=True)
def turned(q, u):
    """Return the normalised q ⊗ exp(u), the attitude after a rotation by the vector u, body axes [rad]."""
    x, y, z = u
    angle = math.sqrt(x * x + y * y + z * z)
    c, s = math.cos(0.5 * angle), 0.5
    if angle > 1e-12:
        s = math.sin(0.5 * angle) / angle
    x, y, z = s * x, s * y, s * z
    a = q[0] * c - q[1] * x - q[2] * y - q[3] * z
    b = q[0] * x + q[1] * c + q[2] * z - q[3] * y
    d = q[0] * y - q[1] * z + q[2] * c + q[3] * x
    e = q[0] * z + q[1] * y - q[2] * x + q[3] * c
    return unit((a, b, d, e))


@njit(cache=True)
def scaled(k, a):
    """Return the vector k a."""
    return k * a[0], k * a[1], k * a[2]


@njit(cache=True)
def moved(x, k, a):
    """Return the vector x + k a."""
    return x[0] + k * a[0], x[1] + k * a[1], x[2] + k * a[2]


@njit(cache=True)
def weighted(a, b, c, d):
    """Return the weighted mean (a + 2 b + 2 c + d) / 6."""
    return (
        (a[0] + 2.0 * (b[0] + c[0]) + d[0]) / 6.0,
        (a[1] + 2.0 * (b[1] + c[1]) + d[1]) / 6.0,
        (a[2] + 2.0 * (b[2] + c[2]) + d[2]) / 6.0,
    )


@njit(cache=True)
def acceleration(p, q):
    """Return the acceleration by force and gravity at an attitude, world axes [m/s²]."""
    f, m = p.force, p.mass
    fx, fy, fz = rotate_core(q[0], q[1], q[2], q[3], f[0] / m, f[1] / m, f[2] / m)
    return fx, fy, fz - GRAVITY


@njit(cache=True)
def advance_body(p):
    """Move one body by one step with a force and a moment that are constant in body axes.

    Args:
        p: Record of `quadsim.motion.rotors.vehicle_dtype`; its state is updated.
    """
    x, v, w, r = p.state.position, p.state.velocity, p.state.ang_vel, p.state.quat
    h, moment, q = p.dt, (p.moment[0], p.moment[1], p.moment[2]), unit(r)
    v1, w1 = (v[0], v[1], v[2]), (w[0], w[1], w[2])
    a1, g1, d1 = acceleration(p, q), angular_acceleration(p.inertia, moment, w1), w1
    v2, w2, u = moved(v1, 0.5 * h, a1), moved(w1, 0.5 * h, g1), scaled(0.5 * h, d1)
    a2 = acceleration(p, turned(q, u))
    g2, d2 = angular_acceleration(p.inertia, moment, w2), dexp_inverse(u, w2)
    v3, w3, u = moved(v1, 0.5 * h, a2), moved(w1, 0.5 * h, g2), scaled(0.5 * h, d2)
    a3 = acceleration(p, turned(q, u))
    g3, d3 = angular_acceleration(p.inertia, moment, w3), dexp_inverse(u, w3)
    v4, w4, u = moved(v1, h, a3), moved(w1, h, g3), scaled(h, d3)
    a4 = acceleration(p, turned(q, u))
    g4, d4 = angular_acceleration(p.inertia, moment, w4), dexp_inverse(u, w4)
    x[0], x[1], x[2] = moved(x, h, weighted(v1, v2, v3, v4))
    v[0], v[1], v[2] = moved(v1, h, weighted(a1, a2, a3, a4))
    w[0], w[1], w[2] = moved(w1, h, weighted(g1, g2, g3, g4))
    r[0], r[1], r[2], r[3] = turned(q, scaled(h, weighted(d1, d2, d3, d4)))
