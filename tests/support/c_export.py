"""The C source of an exported network, compiled and run on readings that are hard to follow."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

DRIVER = Path(__file__).parents[1] / "data" / "loihi" / "driver.c"
SAMPLES = 2000
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2"]


def built(source, name, layout, *flags):
    """Compile an export, strictly: a function from samples (T, ·) to an array of states and outputs."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    program = source / "run"
    command = ["cc", *STRICT, *flags, f"-I{source}", source / f"{name}.c", DRIVER, "-o", program]
    subprocess.run([str(part) for part in command], check=True)

    def run(samples):
        done = subprocess.run([program], input=samples.tobytes(), capture_output=True, check=True)
        return np.frombuffer(done.stdout, layout)

    return run


def hard_readings(seed):
    """Turns up to 40 rad/s and forces up to 150 m/s², rest, and readings that no IMU gives, (T, 6)."""
    rng = np.random.default_rng(seed)
    size = np.repeat(rng.uniform(0, 1, (SAMPLES // 50, 2)) ** 3, 50, axis=0)
    gyro = rng.uniform(-40, 40, (SAMPLES, 3)) * size[:, :1]
    accel = [0, 0, 9.81] + rng.uniform(-150, 150, (SAMPLES, 3)) * size[:, 1:]
    gyro[300:600], accel[300:600] = (0.05, -0.02, 0.01), (0.4, -0.3, 9.8)
    gyro[700:900], accel[700:900] = 40.0, -150.0
    gyro[100:130, 1], accel[200, 0], accel[300:320], gyro[400], accel[500] = np.nan, np.inf, 0.0, 1e30, -1e30
    gyro[650], accel[650] = 5e-324, (0.0, -0.0, 1e-300)
    return np.concatenate([gyro, accel], 1)
