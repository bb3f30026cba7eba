"""Names of the filters, how each is made for the Hummingbird, and the arrays that it runs on."""

from estimators import create

COMPILED = ["complementary", "complementary-adaptive", "mahony", "madgwick", "ekf", "eskf", "ekf-drag", "imm"]
CLASSICAL = [*COMPILED, "ekf-filterpy", "ukf-filterpy", "vqf"]


def arrays(flights, count=2, steps=1000):
    part = flights.isel(flight=slice(count), time=slice(steps))
    return part.gyro.values, part.accel.values, part.quat.values


def make(name, rate_hz=200.0, **params):
    """An estimator for the Hummingbird, whose drag `ekf-drag` needs."""
    return create(name, rate_hz, vehicle="hummingbird", **params)
