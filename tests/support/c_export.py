"""The C source of an exported network, compiled and run."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

DRIVER = Path(__file__).parents[1] / "data" / "loihi" / "driver.c"
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
