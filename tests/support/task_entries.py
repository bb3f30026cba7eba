"""A small task, and entries of strangers: a fair one, and changes that make it break a rule."""

TASK = """version = "small"
description = "Two flights and a hover."
release = "0.3"
closed_loop = "{folder}/loop.toml"
rate_hz = 200.0
most_ms = 2.0
skip_s = 1.0
rules = []
[metrics]
[recipes.home]
recipe = "hummingbird"
flights = 2
duration_s = 3.0
[recipes.hand]
recipe = "hand-held"
flights = 1
duration_s = 3.0
"""
LOOP = """description = "Two short hovers."
scenarios = ["{folder}/level.toml", "{folder}/tilted.toml"]
seeds = 2
seed = 904000000
"""
LEVEL = """description = "Hover."
duration_s = 1.0
"""
TILTED = LEVEL + "start = { tilt_deg = 20.0 }\n"
FAIR = """
import numpy as np

class Mine:
    \"\"\"A complementary filter.\"\"\"

    given = ()  # nothing
    operations = 30

    def __init__(self, rate_hz):
        self.rate_hz = rate_hz

    def reset(self, n=1, roll_pitch=None):
        self.angle = np.zeros((n, 2)) if roll_pitch is None else np.array(roll_pitch, float)

    def update(self, gyro, accel):
        gyro = np.nan_to_num(gyro)
        x, y, z = np.where(np.isfinite(accel), accel, [0.0, 0.0, 9.81]).T
        tilt = np.column_stack([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))])
        self.angle = 0.99 * (self.angle + gyro[:, :2] / self.rate_hz) + 0.01 * tilt
        return self.angle.copy()
"""
READS = """self.rate_hz = rate_hz
        from glob import glob
        for file in glob("{folder}/out/data/home.zarr/quat/c*"):
            with open(file, "rb") as answers:
                answers.read()"""
OBSERVES = "    def observe(self, quat):\n        pass\n"
BAD = [
    ("Sees", ("    def update", f"{OBSERVES}\n    def update"), "received the true attitude"),
    ("Global", ("self.angle", "Global.angle"), "instances share no state"),
    ("Reads", ("self.rate_hz = rate_hz", READS), "which holds the task's data"),
    (
        "Nan",
        ("return self.angle.copy()", "return np.where(np.abs(gyro[:, :1]) > 1.1, np.nan, self.angle)"),
        "finite",
    ),
    ("Crashes", ("gyro = np", "1 / 0\n        gyro = np"), "ends with ZeroDivisionError"),
    (
        "Slow",
        ("gyro = np", "import time; time.sleep(0.003)\n        gyro = np"),
        "ms per sample; 2 ms are allowed",
    ),
    (
        "Constant",
        ("return self.angle.copy()", "return np.zeros_like(self.angle)"),
        "returned the same roll and pitch",
    ),
]
"""Name, what is replaced by what, and the reason that is listed."""
