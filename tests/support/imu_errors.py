"""IMUs with some parts of their error, and motions that they are moved by."""

import numpy as np

from quadsim.imu.spec import ImuSpec, RotorVibration, Sensor, load_imu

RATE = 200.0
ADIS = load_imu("adis16448")
EVERYTHING = load_imu("px4-mini").model_copy(
    update={
        "lever_arm": (0.03, -0.01, 0.02),
        "mounting_deg": (5.0, -10.0, 90.0),
        "vibration": RotorVibration(rotor_vel=450.0, gyro=(0.02, 0.02, 0.01), accel=(1.0, 1.0, 2.0)),
        "dropped": 0.05,
    }
)
PARTS = (set(ImuSpec.model_fields) | set(Sensor.model_fields)) - {"gyro", "accel", "time_constant"}
"""Parts of the error that can be switched off, by the name of their field."""


def without(spec, *parts):
    """The same IMU, or sensor, with some parts of its error off."""
    fields = type(spec).model_fields
    update = {part: fields[part].default for part in parts if part in fields}
    if isinstance(spec, ImuSpec):
        update |= {name: without(getattr(spec, name), *parts) for name in ("gyro", "accel")}
    return spec.model_copy(update=update)


def only(spec, *parts):
    """The same IMU with only some parts of its error."""
    return without(spec, *PARTS.difference(parts))


def flight(n: int, steps: int) -> dict[str, np.ndarray]:
    """Some motion, the same for a vehicle in any batch."""
    time = np.arange(steps) / RATE
    phase = np.arange(n)[:, None, None] + np.arange(3)
    swing = np.sin(2.0 * np.pi * 1.3 * time[None, :, None] + phase)
    turn = np.cos(2.0 * np.pi * 1.3 * time[None, :, None] + phase)
    return {
        "ang_vel": 2.0 * swing,
        "specific_force": 3.0 * turn + [0.0, 0.0, 9.81],
        "ang_acc": 2.0 * np.pi * 2.6 * turn,
        "rotor_vel": 450.0 + 50.0 * swing[..., [0, 1, 2, 0]],
    }


def at_rest(n: int, steps: int) -> dict[str, np.ndarray]:
    force = np.broadcast_to([0.0, 0.0, 9.81], (n, steps, 3))
    return {"ang_vel": np.zeros((n, steps, 3)), "specific_force": force}
