"""Estimators as the command line names them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from estimators.evaluation.comparison import made_of
from quadsim.estimator import AttitudeEstimator
from quadsim.imu.spec import ImuSpec
from quadsim.vehicle import Vehicle


@dataclass(frozen=True)
class Contenders:
    """Estimators to be compared, as the command line names them."""

    names: Sequence[str] | None = None
    """None for all that can be made."""
    tuning: str | None = None
    vehicle: str | None = None

    def create(
        self,
        default: Sequence[str],
        rate_hz: float,
        vehicle: str | Path | Vehicle | None = None,
        imu: ImuSpec | None = None,
    ) -> dict[str, AttitudeEstimator]:
        """Make them; `default` names and the `vehicle` stand in where none are given.

        Raises:
            ValueError: An unknown name, or a filter that needs a vehicle without one.
        """
        return made_of(self.names or default, rate_hz, self.tuning, self.vehicle or vehicle, imu)
