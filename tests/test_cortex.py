"""An exported network on an emulated microcontroller: the emulator's outputs, and what a step takes."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from controllers import CONFIG, random_snn

from estimators import create
from estimators.control.controller import create_controller
from estimators.export.formats import export_weights
from estimators.networks.weights_file import save_network, shipped_controllers

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
cortex = import_module("cortex")
CORES, build, run = cortex.CORES, cortex.build, cortex.run_program
pytestmark = pytest.mark.skipif(
    bool(cortex.missing_tools()), reason=f"needs {', '.join(cortex.missing_tools())}"
)
STEPS = 150


def samples(seed=0):
    """Readings of a flight, some of them missing, and set-points before them (T, 10)."""
    rng = np.random.default_rng(seed)
    wanted = rng.normal([0.0, 0.0, 0.0, 9.81], [0.2, 0.2, 0.5, 1.0], (STEPS, 4))
    gyro, accel = rng.normal(0.0, 1.0, (STEPS, 3)), rng.normal([0.0, 0.0, 9.81], 1.0, (STEPS, 3))
    gyro[40], accel[50], wanted[60], gyro[70] = np.nan, 0.0, np.nan, 1e6
    return np.concatenate([wanted, gyro, accel], 1)


def estimated(name, rows):
    est = create("att-snn-loihi", weights=name)
    found = [(est.update(row[None, :3], row[None, 3:])[0], est.up) for row in rows]
    return np.array([roll_pitch if up is None else up[0] for roll_pitch, up in found])


def controlled(name, rows):
    controller = create_controller(f"{name}-loihi", 200.0)
    controller.reset(1)
    return controller.sequence(*np.split(rows[None], [4, 7], axis=2))[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "core"),
    [
        *((name, CORES[0]) for name in ("att-snn", "att-snn-paper")),
        *((name, CORES[1]) for name in shipped_controllers()),
    ],
)
def test_a_network_has_the_emulators_outputs_and_a_step_fits_500_hz(tmp_path, core, name):
    controls = name in shipped_controllers()
    export_weights(name, tmp_path / "c", "c99")
    program, size = build(tmp_path / "build", tmp_path / "c", controls, core)
    rows = samples()[:, 0 if controls else 4 :]
    done = run(program, core, rows)
    ours = controlled(name, rows) if controls else estimated(name, rows)
    np.testing.assert_array_equal(done.outputs, ours)
    assert done.instructions.sum(axis=1).max() < 100_000
    assert size.flash < 256 * 1024
    assert size.ram < 8 * 1024 or controls


@pytest.mark.slow
def test_the_crazyflies_controller_compiles_against_the_firmwares_declarations(tmp_path):
    example = Path(__file__).parents[1] / "examples" / "crazyflie"
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "snn_controller.c").write_bytes((example / "src" / "snn_controller.c").read_bytes())
    save_network(tmp_path / "control.safetensors", CONFIG, random_snn(CONFIG))
    export_weights(tmp_path / "control.safetensors", tmp_path / "src" / "network", "c99")
    flags = ["-std=gnu11", "-Wall", "-Wextra", "-Werror", "-O2", f"-I{example / 'stub_headers'}"]
    for source in ("snn_controller.c", "network/snn_control.c"):
        command = ["arm-none-eabi-gcc", *CORES[0].flags, *flags, "-c", tmp_path / "src" / source]
        subprocess.run([*map(str, command), "-o", str(tmp_path / "object.o")], check=True)
