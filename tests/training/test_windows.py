"""Windows for other people's loops, and NeuroBench's own runner on them."""

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from estimators import create, run
from estimators.metrics import inclination_rmse
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe
from quadsim.held_out import load_held_out
from quadsim.rotation import roll_pitch_from_quat
from training.windows import Windows


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    out = tmp_path_factory.mktemp("windows") / "data.zarr"
    return generate(load_recipe("hummingbird"), 2, 2.1, out, seed=5, workers=1)


def test_a_loader_gives_windows_of_readings_and_truth(path):
    windows, flights = Windows(path, 100), open_dataset(path)
    assert len(windows) == 2 * 4
    ((readings, truth),) = DataLoader(windows, batch_size=8)
    assert (readings.shape, truth.shape, readings.dtype) == ((8, 100, 6), (8, 100, 2), torch.float32)
    np.testing.assert_array_equal(readings[5, :, 3:], flights["accel"][1, 100:200])
    euler = roll_pitch_from_quat(flights["quat"].to_numpy()[1, 100:200].astype(float))
    np.testing.assert_allclose(truth[5], euler, atol=1e-6)
    with pytest.raises(ValueError, match="no whole flight of 500 samples"):
        Windows(path, 500)


def test_windows_of_a_task_are_for_tests_alone(tmp_path):
    seed = load_held_out("0.3").seed + 9
    out = generate(load_recipe("hand-held"), 1, 0.5, tmp_path / "x.zarr", seed, workers=1, held_out=True)
    with pytest.raises(ValueError, match="is of the held-out suite"):
        Windows(out, 50)
    assert len(Windows(out, 50, held_out=True)) == 2


def test_the_runner_of_neurobench_runs_an_estimator_and_a_network(path):
    pytest.importorskip("neurobench")
    from neurobench.benchmarks import Benchmark
    from neurobench.metrics.static import ParameterCount
    from neurobench.metrics.workload import MSE, SynapticOperations
    from neurobench.models import TorchModel

    from training.neurobench_runner import EstimatorModel, InclinationRmse

    windows = Windows(path, 200)
    loader = DataLoader(windows, batch_size=2)
    found = Benchmark(EstimatorModel(create("mahony")), loader, [], [], [[], [InclinationRmse, MSE]]).run(
        quiet=True
    )
    gyro, accel = windows.readings[..., :3].numpy(), windows.readings[..., 3:].numpy()
    errors = inclination_rmse(run(create("mahony"), gyro, accel), windows.truth.numpy())
    assert found["InclinationRmse"] == pytest.approx(errors.mean, rel=1e-4)
    net = TorchModel(torch.nn.Sequential(torch.nn.Linear(6, 2)))
    found = Benchmark(net, loader, [], [], [[ParameterCount], [InclinationRmse, SynapticOperations]]).run(
        quiet=True
    )
    assert found["ParameterCount"] == 14
    assert found["SynapticOperations"]["Dense"] > 0
