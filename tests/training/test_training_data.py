"""Windows of flights for our loop, for other people's, and for NeuroBench's own runner."""

from itertools import pairwise

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
from training.config import make_config
from training.data import attitude_windows, load_training_flights, split_flights, split_ids
from training.windows import Windows


def test_windows_of_a_stream_are_successive(dataset):
    flights = load_training_flights([dataset])
    config = make_config(data="x", batches=12, batch_size=20, windows_per_stream=4, imu="perfect")
    batches = list(attitude_windows(flights, config, 100, (0, 1)))
    assert batches[0].reset.all()
    reset = np.array([batch.reset for batch in batches[1:]])
    assert 0 < reset.mean() < 1
    flown = [flight.tobytes() for flight in flights.ang_vel]
    for before, after in pairwise(batches):
        for row in np.flatnonzero(~after.reset):
            joined = np.concatenate([before.gyro[row], after.gyro[row]]).tobytes()
            assert any(joined in flight for flight in flown)
    again = list(attitude_windows(flights, config, 100, (0, 1)))
    np.testing.assert_array_equal(batches[7].accel, again[7].accel)


def test_streams_of_a_batch_differ_and_do_not_depend_on_how_many_others_there_are(dataset):
    flights = load_training_flights([dataset])
    sizes = (8, 12)  # one stream in each of eight cohorts; two in four of them, one in the others
    configs = (make_config(data="x", batches=6, batch_size=size, windows_per_stream=4) for size in sizes)
    few, more = (list(attitude_windows(flights, config, 100, (0, 1))) for config in configs)
    for batch in more:
        assert len(np.unique(batch.accel[:, 0], axis=0)) == 12
    resets = np.array([batch.reset for batch in few])
    assert len(np.unique(resets, axis=1).T) > 4
    for one, other in zip(few, more, strict=True):
        for alone, among in zip(one[:4], other[:4], strict=True):
            np.testing.assert_array_equal(alone[4:], among[8:])


def test_a_stream_lasts_from_one_window_to_the_most(dataset):
    flights = load_training_flights([dataset])
    config = make_config(data="x", batches=300, batch_size=8, windows_per_stream=4)
    starts = np.array([batch.reset for batch in attitude_windows(flights, config, 20, (3, 1))])
    lengths = np.concatenate([np.diff(np.flatnonzero(column)) for column in starts.T])
    assert set(lengths) == {1, 2, 3, 4}
    shares = np.bincount(lengths)[1:] / lengths.size  # evenly in the logarithm, up to 5
    np.testing.assert_allclose(shares, np.diff(np.log([1, 2, 3, 4, 5])) / np.log(5), atol=0.06)


def test_split_has_every_flight_once():
    parts = split_ids(35, seed=0)
    assert [len(p) for p in parts] == [24, 7, 4]
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(35))


def test_windows_that_do_not_fit_the_flights_are_refused(dataset):
    with pytest.raises(ValueError, match="windows of 1000 samples, but the flights have 800: give a smaller"):
        split_flights(make_config(data=dataset, window_s=5.0))


def test_a_loader_gives_windows_of_readings_and_truth(dataset):
    windows, flights = Windows(dataset, 150), open_dataset(dataset)
    assert len(windows) == 5 * 5
    ((readings, truth),) = DataLoader(windows, batch_size=25)
    assert (readings.shape, truth.shape, readings.dtype) == ((25, 150, 6), (25, 150, 2), torch.float32)
    np.testing.assert_array_equal(readings[6, :, 3:], flights["accel"][1, 150:300])
    euler = roll_pitch_from_quat(flights["quat"].to_numpy()[1, 150:300].astype(float))
    np.testing.assert_allclose(truth[6], euler, atol=1e-6)
    with pytest.raises(ValueError, match="no whole flight of 900 samples"):
        Windows(dataset, 900)


def test_windows_of_a_task_are_for_tests_alone(tmp_path):
    seed = load_held_out("0.3").seed + 9
    out = generate(load_recipe("hand-held"), 1, 0.5, tmp_path / "x.zarr", seed, workers=1, held_out=True)
    with pytest.raises(ValueError, match="is of the held-out suite"):
        Windows(out, 50)
    assert len(Windows(out, 50, held_out=True)) == 2


def test_the_runner_of_neurobench_runs_an_estimator_and_a_network(dataset):
    pytest.importorskip("neurobench")
    from neurobench.benchmarks import Benchmark
    from neurobench.metrics.static import ParameterCount
    from neurobench.metrics.workload import MSE, SynapticOperations
    from neurobench.models import TorchModel

    from training.neurobench_runner import EstimatorModel, InclinationRmse

    windows = Windows(dataset, 200)
    loader = DataLoader(windows, batch_size=2)
    mahony = EstimatorModel(create("mahony"))
    found = Benchmark(mahony, loader, [], [], [[], [InclinationRmse, MSE]]).run(quiet=True)
    gyro, accel = windows.readings[..., :3].numpy(), windows.readings[..., 3:].numpy()
    errors = inclination_rmse(run(create("mahony"), gyro, accel), windows.truth.numpy())
    assert found["InclinationRmse"] == pytest.approx(errors.mean, rel=1e-4)
    net = TorchModel(torch.nn.Sequential(torch.nn.Linear(6, 2)))
    metrics = [[ParameterCount], [InclinationRmse, SynapticOperations]]
    found = Benchmark(net, loader, [], [], metrics).run(quiet=True)
    assert found["ParameterCount"] == 14
    assert found["SynapticOperations"]["Dense"] > 0
