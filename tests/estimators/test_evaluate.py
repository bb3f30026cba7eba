"""The offline comparison: its table, its curves and its figures."""

import re
import sys
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from estimators import create, run
from estimators.evaluation.comparison import behind_the_best, evaluate, silenced_twin, tilted_starts
from estimators.evaluation.error_figures import settling, violins
from estimators.evaluation.flights import load_flights
from estimators.metrics import attitude_error, inclination_error
from quadsim.rotation import roll_pitch_from_quat
from scenarios.report.evaluation import columns, evaluation_notes, headline
from scenarios.report.terminal import rows_table


@pytest.fixture(scope="module")
def evaluation(flights):
    return evaluate(flights, ["truth", "mahony", "eskf"], settle_s=10.0)


def test_truth_is_without_error_and_settled_from_the_start(evaluation):
    for row in evaluation.rows[:2]:
        assert (row.estimator, row.mean_deg, row.sd_deg, row.inclination_rmse_deg) == ("truth", 0, 0, 0)
        assert row.settle_20_s == 0.0
        assert np.isnan(row.settle_45_s)  # these flights never tilt so far


def test_rows_hold_what_the_metrics_say(evaluation, flights):
    gyro, accel = flights.gyro.values, flights.accel.values
    truth = roll_pitch_from_quat(flights.quat.values)
    rows = {(row.estimator, row.initial): row for row in evaluation.rows}
    unknown = attitude_error(run(create("mahony"), gyro, accel), truth)
    known = attitude_error(run(create("mahony"), gyro[:, 1:], accel[:, 1:], truth[:, 0]), truth[:, 1:])
    for start, error in (("unknown", unknown), ("known", known)):
        row = rows["mahony", start]
        assert (row.median_deg, row.mean_deg, row.sd_deg) == (error.median, error.mean, error.sd)
        assert row.mean_low_deg <= row.mean_deg <= row.mean_high_deg
        np.testing.assert_array_equal(evaluation.sequences["mahony", start], error.sequences)
    assert rows["mahony", "known"].runtime_ns > 0.0


def test_an_estimator_is_compared_with_the_best_flight_by_flight(evaluation):
    rows = {(row.estimator, row.initial): row for row in evaluation.rows}
    for start in ("unknown", "known"):
        means = {name: rows[name, start].mean_deg for name in ("mahony", "eskf")}
        best, other = sorted(means, key=lambda name: means[name])
        assert (rows[best, start].behind_low_deg, rows[best, start].behind_high_deg) == (0.0, 0.0)
        assert rows[other, start].behind_deg == pytest.approx(means[other] - means[best])
        assert rows[other, start].behind_low_deg <= rows[other, start].behind_deg


def test_slow_estimators_are_run_on_fewer_flights_and_missing_samples_are_counted(flights, caplog):
    gyro = flights.gyro.values.copy()
    gyro[0, 100:103] = np.nan
    part = flights.assign(gyro=(flights.gyro.dims, gyro)).isel(time=slice(400))
    done = evaluate(part, ["mahony", "ekf-filterpy"], initial=("unknown",), settle_s=0.5, slow_flights=1)
    assert [(row.flights, row.missing) for row in done.rows] == [(4, 3), (1, 3)]
    assert done.sequences["ekf-filterpy", "unknown"].shape == (1,)
    assert not caplog.records  # the table says it once
    assert any("3 samples were missing" in note for note in evaluation_notes(done))
    assert any("ekf-filterpy on the first 1" in note for note in evaluation_notes(done))


class Plain:
    """Integrates the gyroscope; what a test changes of it is in its subclass."""

    rate_hz = 200.0

    def reset(self, n=1, roll_pitch=None):
        self.angle = np.zeros((n, 2)) if roll_pitch is None else np.array(roll_pitch)
        self.samples = 0

    def update(self, gyro, accel):
        self.samples += 1
        self.angle = self.angle + gyro[:, :2] / self.rate_hz
        return self.angle


def updating(name, change):
    update = Plain.update
    return type(name, (Plain,), {"update": lambda self, *readings: change(self, update(self, *readings))})


class Peek(Plain):
    """The truth, under another name."""

    def observe(self, quat):
        self.truth = roll_pitch_from_quat(quat)

    def update(self, gyro, accel):
        return self.truth


class Faster(Plain):
    def sequence(self, gyro, accel):
        return np.stack([0.5 * np.arctan2(accel[..., 1], accel[..., 2]), -accel[..., 0] / 9.81], axis=-1)


class Same(Plain):
    def sequence(self, gyro, accel):
        self.samples += gyro.shape[1]
        return self.angle[:, None] + np.cumsum(gyro[..., :2], axis=1) / self.rate_hz


class Late(Same):
    """Has a `sequence` that equals its `update` until shortly before the end."""

    def sequence(self, gyro, accel):
        out = super().sequence(gyro, accel)
        out[:, 900:] *= 0.9
        return out


SAME = "returned the same roll and pitch at every sample"
OTHER = "sequence does not give the estimates of update"
RETURNS = "update returns a"
HOSTILE = [
    # any wrap at double precision makes it 0
    (lambda est, angles: np.full_like(angles, 1e20), "returned angles beyond ±100 rad in 100.0 % of the"),
    (lambda est, angles: 0.0 * angles, SAME),
    (Peek, ""),
    (lambda est, angles: sys.exit(0), "did not run: Bad ends with SystemExit: 0"),
    (lambda est, angles: {}["x"], "did not run: Bad ends with KeyError: 'x'"),
    (lambda est, angles: angles[:, :1], rf"did not run: Bad: {RETURNS} float64 array of shape \(4, 1\); .*2"),
    (lambda est, angles: np.ma.masked_array(angles, True), f"did not run: Bad: {RETURNS} masked array"),
    (Faster, f"did not run: Faster: {OTHER}"),
    (Late, f"did not run: Late: {OTHER}"),
]


@pytest.mark.parametrize(("made", "flaw"), HOSTILE)
def test_what_cannot_be_ranked_is_listed_with_its_reason_and_is_not_the_best(flights, made, flaw):
    part = flights.isel(time=slice(1000))
    made = made if isinstance(made, type) else updating("Bad", made)
    done = evaluate(part, {"bad": made(), "mahony": create("mahony")}, settle_s=1.0)
    rows = {(row.estimator, row.initial): row for row in done.rows}
    for start in ("unknown", "known"):
        assert rows["bad", start].unranked
        assert re.match(flaw, rows["bad", start].flaw)
        assert behind_the_best(rows["bad", start]) in ("reference", "not ranked")
        assert not rows["bad", start].tied
        assert behind_the_best(rows["mahony", start]) == "the best"
        assert rows["mahony", start].behind_deg == 0.0
    notes = evaluation_notes(done)
    assert any(note.startswith("bad ") for note in notes)
    for draw in (violins, settling):
        draw(done)
    shown = columns(done)
    assert rows_table(shown).row_count == len(shown)
    assert headline(done.rows).startswith("mahony has the smallest error from an unknown start")
    assert all(each["mean [°]"] is None or each["mean [°]"] >= 0.0 for each in shown)
    with (
        pytest.raises(ValueError, match="no estimator ran: bad did not run")
        if np.isnan(rows["bad", "unknown"].mean_deg)
        else nullcontext()
    ):
        evaluate(part, {"bad": made()}, settle_s=1.0)


def test_an_estimator_that_fails_half_way_does_not_win(flights):
    failing = updating("Failing", lambda est, angles: 0.0 * angles if est.samples < 2000 else angles + np.nan)
    done = evaluate(flights, {"failing": failing(), "mahony": create("mahony")}, initial=("unknown",))
    failing, mahony = done.rows
    assert failing.without_number == pytest.approx(0.5, abs=0.1)
    assert mahony.without_number == 0.0
    assert failing.mean_deg > 80.0 > mahony.mean_deg
    reason = "failing is not ranked (unknown start): it returned roll or pitch that is not a finite number"
    assert reason in " ".join(evaluation_notes(done))
    assert (behind_the_best(failing), behind_the_best(mahony)) == ("not ranked", "the best")


def test_a_sequence_that_equals_update_is_scored(flights):
    part = flights.isel(time=slice(1000))
    made = {"same": Same(), "plain": Plain(), "off": updating("Off", lambda est, angles: angles + 0.5)()}
    same, plain, off = evaluate(part, made, initial=("unknown",), settle_s=1.0).rows
    assert not same.unranked
    assert (same.tied, plain.tied, off.tied) == (True, True, False)
    assert same.mean_deg == pytest.approx(plain.mean_deg)


def test_one_flight_has_no_interval(flights):
    done = evaluate(flights.isel(flight=[0]), ["mahony", "ekf"], initial=("unknown",), settle_s=1.0)
    for row in columns(done):
        assert (row["95 %"], row["SD [°]"]) == (None, None)
        assert "(" not in row["error minus the best [°]"]


def test_run_refuses_a_sequence_that_differs_from_update_and_leaves_the_last_state(flights):
    gyro, accel = flights.gyro.values[:, :1000], flights.accel.values[:, :1000]
    with pytest.raises(ValueError, match="Faster: sequence does not give the estimates of update"):
        run(Faster(), gyro, accel)
    run(same := Same(), gyro, accel)
    assert same.samples == 1000


def test_an_interrupt_stays_one(flights):
    def interrupt(est, angles):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        evaluate(flights, {"bad": updating("Bad", interrupt)(), "mahony": create("mahony")})


def test_an_estimator_that_changes_what_it_is_given_changes_nothing_else(flights):
    class Writes(Same):
        def reset(self, n=1, roll_pitch=None):
            super().reset(n, roll_pitch)
            if roll_pitch is not None:
                roll_pitch[:] = 9.0

        def sequence(self, gyro, accel):
            out = super().sequence(gyro, accel)
            gyro[:] = accel[:] = 0.0
            return out

    part = flights.isel(time=slice(1000))
    alone = evaluate(part, {"mahony": create("mahony")}, settle_s=1.0).rows
    after = evaluate(part, {"writes": Writes(), "mahony": create("mahony")}, settle_s=1.0).rows
    assert [row.mean_deg for row in alone] == [row.mean_deg for row in after if row.estimator == "mahony"]


@pytest.mark.parametrize("tilt", [5.0, 20.0])
def test_recovery_starts_in_the_tilt_it_says(flights, tilt):
    pieces = tilted_starts(load_flights([flights]), tilt, 1000)
    start = inclination_error(pieces.truth[:, 0], np.zeros_like(pieces.truth[:, 0]))
    np.testing.assert_allclose(start, tilt, atol=1.0)
    assert pieces.gyro.shape[1:] == (1000, 3)
    assert tilted_starts(load_flights([flights]), 120.0, 1000) is None


@pytest.mark.parametrize(
    ("level_s", "settled_s"), [(0.0, 0.0), (0.02, 0.0), (0.5, 0.5), (0.6, 1.0), (9.0, np.nan)]
)
def test_recovery_time_is_the_end_of_the_last_block_that_is_not_below_2_degrees(flights, level_s, settled_s):
    """Blocks of 0.5 s: 0.02 s of a tilt of 20° average to 0.8°, 0.1 s in the second block to more than 2°."""

    class Recovering(Peek):
        def update(self, gyro, accel):
            super(Peek, self).update(gyro, accel)
            return self.truth * (self.samples > round(level_s * self.rate_hz))

    done = evaluate(flights, {"recovering": Recovering()}, initial=("unknown",), settle_s=2.0)
    np.testing.assert_equal(done.rows[0].settle_20_s, settled_s)


def test_a_silenced_network_estimates_level(flights):
    gyro, accel = flights.gyro.values[:1, :100], flights.accel.values[:1, :100]
    for name in ("att-snn", "att-snn-loihi", "att-rnn"):
        assert not run(silenced_twin(name), gyro, accel).any()
    assert silenced_twin("mahony") is None


def test_a_network_has_its_silenced_error_beside_it_and_no_known_start(flights):
    rows = evaluate(flights, ["att-snn", "mahony"], settle_s=2.0).rows
    assert [(row.estimator, row.initial) for row in rows] == [
        ("att-snn", "unknown"), ("mahony", "unknown"), ("mahony", "known"),
    ]  # fmt: skip
    truth = roll_pitch_from_quat(flights.quat.values)
    assert rows[0].silenced_deg == pytest.approx(attitude_error(np.zeros_like(truth), truth).mean)
    assert all(np.isnan(row.silenced_deg) for row in rows[1:])


def test_table_goes_to_csv(evaluation, tmp_path):
    path = tmp_path / "new" / "table.csv"
    evaluation.write_csv(path)
    for column in ("estimator", "mean_deg"):
        assert pd.read_csv(path)[column].tolist() == [getattr(row, column) for row in evaluation.rows]


def test_figures_are_drawn_and_each_estimator_has_a_panel_of_its_recovery(evaluation, tmp_path):
    violins(evaluation).savefig(tmp_path / "violins.png")
    assert (tmp_path / "violins.png").stat().st_size > 5_000
    names = list(dict.fromkeys(name for name, _ in evaluation.settling if name != "truth"))
    panels = [axes for axes in settling(evaluation).axes if axes.axison]
    assert [axes.get_title(loc="left") for axes in panels] == names
    coloured = [[line.get_label() for line in axes.get_lines()] for axes in panels]
    assert all("from 20°" in labels and "from 45°" not in labels for labels in coloured)  # never so tilted
    (curve,) = [line for line in panels[0].get_lines() if line.get_label() == "from 20°"]
    np.testing.assert_allclose(curve.get_xdata(), 0.25 + 0.5 * np.arange(20))  # middles of blocks of 10 s


def test_recovery_is_left_out_and_explained_where_no_flight_is_long_enough(evaluation):
    assert ("20° to 2° [s]" in columns(evaluation)[0], "45° to 2° [s]" in columns(evaluation)[0]) == (
        True,
        False,
    )
    assert not any("convergence" in note for note in evaluation_notes(evaluation))
    short = replace(evaluation, settling=dict.fromkeys(evaluation.settling, np.empty(0)))
    assert "20° to 2° [s]" not in columns(short)[0]
    assert "too short or too level to measure convergence" in evaluation_notes(short)[0]


def test_a_dataset_that_is_not_one_is_named(flights):
    with pytest.raises(ValueError, match="the dataset has no accel"):
        evaluate(flights.drop_vars("accel"), ["mahony"])


def test_filters_on_real_recordings_with_optical_truth(broad):
    """BROAD trials, hand-moved: package defaults; scored where the benchmark marks movement."""
    given = {"madgwick": {"beta": 0.033}, "ekf": {"gyro_noise": 0.003, "accel_noise": 0.01}}
    errors = {name: [] for name in given}
    for file in broad[::4]:
        data = np.load(file)
        rate = 1.0 / np.median(np.diff(data["t"]))
        truth = roll_pitch_from_quat(data["quat"])
        scored = data["valid"] & data["movement"] & (data["t"] > 3.0)
        for name, found in errors.items():
            out = run(create(name, rate, **given[name]), data["gyro"][None], data["acc"][None])
            found.append(np.sqrt(np.mean(inclination_error(out[0], truth)[scored] ** 2)))
    assert np.mean(errors["madgwick"]) < 2.5
    assert np.mean(errors["ekf"]) < 3.0
