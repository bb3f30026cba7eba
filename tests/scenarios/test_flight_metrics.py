"""Metrics of a closed-loop flight, from its log."""

import numpy as np
import pandas as pd
from flown import crash, table

from quadsim.vehicle import load_vehicle
from scenarios.bench.flight_log import log_dtype
from scenarios.bench.flight_metrics import convergence_time, error_histogram, flight_metrics, recovery_time
from scenarios.bench.results import summarise, wilson

HUMMINGBIRD = load_vehicle("hummingbird")


def steady_log(n=2, steps=400):
    log = np.zeros((n, steps), log_dtype(4))
    log["rotor_vel"] = HUMMINGBIRD.hover_rotor_vel
    return log, np.full(n, steps)


def metrics_of(log, end):
    return flight_metrics(log, end, 200.0, HUMMINGBIRD)


def test_a_perfect_hover_has_no_error_and_the_power_that_carries_the_weight():
    metrics = metrics_of(*steady_log())
    power = HUMMINGBIRD.mass * 9.81 * HUMMINGBIRD.motor.k_m * HUMMINGBIRD.hover_rotor_vel
    np.testing.assert_allclose(metrics.pop("power_w"), power)
    np.testing.assert_array_equal(list(metrics.values()), 0.0)


def test_every_metric_is_of_its_own_signal():
    log, end = steady_log()
    log["tracking"][:, ::2] = np.radians(10.0)
    log["tilt"][:, 7] = np.radians(40.0)
    log["command_change"] = np.resize([3.0, 4.0], 400)
    log["estimate"][:, ::2] = np.radians([3.0, 0.0])
    log["position"] = [0.3, 0.0, 0.4]
    wanted = {
        "attitude_deg": 10.0 / np.sqrt(2.0),
        "worst_tilt_deg": 40.0,
        "jitter": np.sqrt((3.0**2 + 4.0**2) / 2.0),
        "inclination_deg": 3.0 / np.sqrt(2.0),
        "error_deg": 0.75,
        "position_m": 0.5,
    }
    metrics = metrics_of(log, end)
    np.testing.assert_allclose([metrics[key][0] for key in wanted], list(wanted.values()))


def test_errors_are_counted_in_twenty_parts_of_each_decade_from_a_thousandth_of_a_degree():
    log, end = steady_log(1, 10)
    log["estimate"][0, :4] = np.radians([3.0, -1.2])
    counts = error_histogram(log, end)
    found = {int(part): int(counts[part]) for part in np.flatnonzero(counts)}
    assert found == {0: 12, int(20 * np.log10(1.2e3)): 4, int(20 * np.log10(3e3)): 4}


def test_nothing_after_a_crash_counts():
    log, end = steady_log()
    log[0, 100:] = np.nan
    end[0] = 100
    np.testing.assert_array_equal(metrics_of(log, end)["error_deg"], 0.0)
    assert error_histogram(log, end).sum() == 2 * (100 + 400)


def test_time_to_converge_is_the_start_of_the_first_second_below_the_limit():
    error = np.full((3, 1000), 20.0)
    error[0, 300:] = 1.0
    error[1, 100:250] = 1.0  # three quarters of a second are not enough
    error[1, 600:] = 1.0
    np.testing.assert_array_equal(convergence_time(error, 200.0), [1.5, 3.0, np.nan])


def test_recovery_is_the_longest_spell_away_that_ended():
    apart = np.zeros((5, 1000))
    apart[0, 100:150] = apart[0, 300:500] = 2.0
    apart[1, 700:] = 2.0  # still away at the end
    apart[2, 10:30] = 2.0  # back, but crashed later
    apart[4, 100:120] = apart[4, 990:] = 2.0  # thrown off again at the very end
    whole = np.array([True, True, False, True, True])
    np.testing.assert_array_equal(recovery_time(apart, whole, 200.0), [1.0, np.nan, np.nan, 0.0, 0.1])


def test_wilson_interval_of_textbook_values():
    found = wilson(pd.Series([0, 5, 10, 0]), pd.Series([10, 10, 10, 0]))  # Brown, Cai, DasGupta 2001
    np.testing.assert_allclose(found, [[0.0, 0.2366, 0.7225, 0.0], [0.2775, 0.7634, 1.0, 1.0]], atol=1e-4)


def test_median_convergence_is_empty_when_most_never_converge_and_a_crash_counts_to_the_tilt():
    flights = table(*((name, "x", k, crash(1.0) if k == 2 else 0.5) for name in "ab" for k in range(3)))
    flights["converge_s"] = [1.0, 1.0, np.nan, 1.0, np.nan, np.nan]
    flights["worst_tilt_deg"] = [10.0, 20.0, 80.0, 30.0, np.nan, np.nan]
    found = summarise(flights)
    np.testing.assert_array_equal(found["converge_s"], [1.0, np.nan])
    np.testing.assert_array_equal(found["worst_tilt_deg"], [80.0, 30.0])
