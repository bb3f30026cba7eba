from itertools import pairwise

import numpy as np
import pytest

from training.config import make_config
from training.data import flights_of, load_training_flights, network_inputs, split, windows


def test_windows_of_a_stream_are_successive(dataset):
    flights = load_training_flights([dataset])
    config = make_config(data="x", batches=12, batch_size=20, windows_per_stream=4, imu="perfect")
    batches = list(windows(flights, config, 100, (0, 1)))
    assert batches[0].reset.all()
    reset = np.array([batch.reset for batch in batches[1:]])
    assert 0 < reset.mean() < 1
    flown = [flight.tobytes() for flight in flights.ang_vel]
    for before, after in pairwise(batches):
        for row in np.flatnonzero(~after.reset):
            joined = np.concatenate([before.gyro[row], after.gyro[row]]).tobytes()
            assert any(joined in flight for flight in flown)
    again = list(windows(flights, config, 100, (0, 1)))
    np.testing.assert_array_equal(batches[7].accel, again[7].accel)


def test_streams_of_a_batch_differ_and_do_not_depend_on_how_many_others_there_are(dataset):
    flights = load_training_flights([dataset])
    sizes = (8, 12)  # one stream in each of eight cohorts; two in four of them, one in the others
    configs = (make_config(data="x", batches=6, batch_size=size, windows_per_stream=4) for size in sizes)
    few, more = (list(windows(flights, config, 100, (0, 1))) for config in configs)
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
    starts = np.array([batch.reset for batch in windows(flights, config, 20, (3, 1))])
    lengths = np.concatenate([np.diff(np.flatnonzero(column)) for column in starts.T])
    assert set(lengths) == {1, 2, 3, 4}
    shares = np.bincount(lengths)[1:] / lengths.size  # evenly in the logarithm, up to 5
    np.testing.assert_allclose(shares, np.diff(np.log([1, 2, 3, 4, 5])) / np.log(5), atol=0.06)


@pytest.mark.parametrize(
    "model",
    ["att-snn", "att-rnn"],
)
def test_networks_are_fed_scaled_readings_and_nothing_else(dataset, model):
    config = make_config(
        data=dataset,
        model=model,
        inputs={"gyro": 2.5, "accel": (1.0, 1.0, 4.0), "accel_offset": (0.0, 0.0, 9.81)},
        batches=3,
        batch_size=8,
        windows_per_stream=2,
    )
    scaling = config.inputs
    for batch in windows(load_training_flights([dataset]), config, 100, (0, 1)):
        readings = np.concatenate([batch.gyro, batch.accel - np.array(scaling.accel_offset)], 2)
        expected = readings / np.array([*[scaling.gyro] * 3, *scaling.accel])
        x = network_inputs(config, batch).numpy()
        np.testing.assert_allclose(x, expected, rtol=0, atol=1 / 2048 + 1e-6)


def test_split_has_every_flight_once():
    parts = split(35, seed=0)
    assert [len(p) for p in parts] == [24, 7, 4]
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(35))


def test_windows_that_do_not_fit_the_flights_are_refused(dataset):
    with pytest.raises(ValueError, match="windows of 1000 samples, but the flights have 800: give a smaller"):
        flights_of(make_config(data=dataset, window_s=5.0))
