"""`estimators.check_estimator` passes what ships, and names what a broken estimator does."""

import numpy as np
import pytest

import estimators
from estimators import check_estimator


class Fair:
    """A complementary filter."""

    def __init__(self, rate_hz):
        self.dt = 1.0 / rate_hz

    def reset(self, n=1, roll_pitch=None):
        self.angle = np.zeros((n, 2)) if roll_pitch is None else np.array(roll_pitch, float)

    def update(self, gyro, accel):
        gyro, accel = np.nan_to_num(gyro), np.where(np.isfinite(accel), accel, [0.0, 0.0, 9.81])
        tilt = np.arctan2(accel[:, 1], accel[:, 2]), np.arctan2(-accel[:, 0], accel[:, 2])
        self.angle = 0.98 * (self.angle + self.dt * gyro[:, :2]) + 0.02 * np.column_stack(tilt)
        return self.angle


@pytest.mark.parametrize("name", estimators.names())
def test_every_estimator_that_ships_passes(name):
    check_estimator(name)


def test_a_plain_class_passes_at_any_rate():
    check_estimator(Fair)
    check_estimator(Fair, rate_hz=1000.0)


class Transposed(Fair):
    def update(self, gyro, accel):
        return super().update(gyro, accel).T if len(gyro) == 3 else super().update(gyro, accel)


class Infinite(Fair):
    def update(self, gyro, accel):
        return super().update(gyro, accel) / np.where(np.abs(gyro[:, :1]) > 1.0, np.nan, 1.0)


class Tilted(Fair):
    def update(self, gyro, accel):
        return super().update(gyro, accel) + 0.2


class Mixed(Fair):
    def update(self, gyro, accel):
        return super().update(gyro, accel) - self.angle.mean(0)


class OtherSequence(Fair):
    def sequence(self, gyro, accel):
        return np.zeros((*gyro.shape[:2], 2))


class Random(Fair):
    def update(self, gyro, accel):
        return super().update(gyro, accel) + np.random.default_rng().normal(0, 1e-3, (len(gyro), 2))


class Remembers(Fair):
    def reset(self, n=1, roll_pitch=None):
        if not hasattr(self, "angle") or len(self.angle) != n:
            super().reset(n, roll_pitch)


class Writes(Fair):
    def update(self, gyro, accel):
        out = super().update(gyro, accel)
        gyro *= 2.0
        return out


class OneArray(Fair):
    def update(self, gyro, accel):
        if not hasattr(self, "out") or len(self.out) != len(gyro):
            self.out = np.empty((len(gyro), 2))
        self.out[:] = super().update(gyro, accel)
        return self.out


class Forever(Fair):
    def update(self, gyro, accel):
        self.angle = self.angle + self.dt * gyro[:, :2] * 0.01
        return self.angle


class Deaf(Fair):
    def reset(self, n=1, roll_pitch=None):
        super().reset(n, None if roll_pitch is None else np.full((n, 2), np.nan))


@pytest.mark.parametrize(
    ("broken", "check"),
    [
        (Transposed, "shapes"),
        (Infinite, "finite"),
        (Tilted, "at_rest"),
        (Mixed, "batch_equals_single"),
        (OtherSequence, "sequence_equals_stream"),
        (Random, "batch_equals_single|deterministic"),
        (Remembers, "reset"),
        (Writes, "keeps_its_input"),
        (OneArray, "output_stays"),
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
