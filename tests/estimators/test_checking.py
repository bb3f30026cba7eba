"""`estimators.check_estimator` passes what ships, and names what a broken estimator does."""

import numpy as np
import pytest
from task_entries import FAIR

import estimators
from estimators import check_estimator
from estimators.custom import made_by

exec(FAIR, namespace := {})
Fair = namespace["Mine"]


@pytest.mark.parametrize("name", estimators.names())
def test_every_estimator_that_ships_passes(name):
    check_estimator(name)


def test_a_plain_class_passes_at_any_rate():
    check_estimator(Fair)
    check_estimator(Fair, rate_hz=1000.0)
    assert made_by("Fair", Fair, 1000.0, {}).rate_hz == 1000.0


def spoiled(spoil):
    """An estimator whose update returns what `spoil` makes of it, of the right estimate and the rates."""

    class Broken(Fair):
        def update(self, gyro, accel):
            return spoil(self, super().update(gyro, accel), gyro)

    return Broken


def write(est, out, gyro):
    gyro *= 2.0
    return out


def reuse(est, out, gyro):
    if not hasattr(est, "out") or len(est.out) != len(out):
        est.out = np.empty_like(out)
    est.out[:] = out
    return est.out


def add_noise(est, out, gyro):
    return out + np.random.default_rng().normal(0, 1e-3, out.shape)


class OtherSequence(Fair):
    def sequence(self, gyro, accel):
        return np.arctan2(np.stack([accel[..., 1], -accel[..., 0]], axis=-1), accel[..., 2:])


class Remembers(Fair):
    def reset(self, n=1, roll_pitch=None):
        if not hasattr(self, "angle") or len(self.angle) != n:
            super().reset(n, roll_pitch)


class Forever(Fair):
    def update(self, gyro, accel):
        self.angle = self.angle + 0.0 * gyro[:, :2]
        return super().update(gyro, accel)


class Deaf(Fair):
    def reset(self, n=1, roll_pitch=None):
        super().reset(n, None if roll_pitch is None else np.full((n, 2), np.nan))


class Shared(Fair):
    def reset(self, n=1, roll_pitch=None):
        super().reset(n, roll_pitch)
        Shared.kept = self.angle

    def update(self, gyro, accel):
        self.angle = Shared.kept
        Shared.kept = super().update(gyro, accel)
        return Shared.kept.copy()


@pytest.mark.parametrize(
    ("broken", "check"),
    [
        (spoiled(lambda est, out, gyro: out.T if len(gyro) == 3 else out), "shapes"),
        (spoiled(lambda est, out, gyro: out / np.where(np.abs(gyro[:, :1]) > 1, np.nan, 1)), "finite"),
        (spoiled(lambda est, out, gyro: out + 0.2), "at_rest"),
        (spoiled(lambda est, out, gyro: 0.0 * out), "at_rest"),
        (spoiled(lambda est, out, gyro: np.degrees(out)), "at_rest"),
        (spoiled(lambda est, out, gyro: out - 0.2 * (len(out) > 1) * out.mean(0)), "batch_equals_single"),
        (spoiled(add_noise), "batch_equals_single|repeatable"),
        (spoiled(write), "keeps_arrays"),
        (spoiled(reuse), "keeps_arrays"),
        (OtherSequence, "sequence_equals_stream"),
        (Remembers, "repeatable"),
        (Shared, "instances_apart"),
        (Forever, "missing_samples"),
        (Deaf, "known_start"),
    ],
)
def test_what_is_broken_is_named(broken, check):
    with pytest.raises(ValueError, match=f"^{broken.__name__}( fails ({check})|: update returns)"):
        check_estimator(broken)


def test_what_is_no_estimator_is_refused():
    with pytest.raises(ValueError, match="has no reset and no update"):
        check_estimator(lambda rate_hz: 1.0)
    with pytest.raises(ValueError, match="unknown estimator"):
        check_estimator("madwick")
