"""Estimators as the command line names them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from estimators import create
from estimators.evaluation.comparison import made_of
from estimators.networks.weights_file import load_network
from quadsim.estimator import AttitudeEstimator
from quadsim.imu.spec import ImuSpec
from quadsim.vehicle import Vehicle


@dataclass(frozen=True)
class Contenders:
    """Estimators to be compared, as the command line names them."""

    names: Sequence[str] | None = None
    """None for all that can be made."""
    weights: Sequence[str] = ()
    """Weights files, each under its path."""
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
            ValueError: Weights of another kind of network, or given twice; a filter that needs a vehicle
                without one.
        """
        made = made_of(self.names or default, rate_hz, self.tuning, self.vehicle or vehicle, imu)
        for path in self.weights:
            if path in made:
                raise ValueError(f"--weights {path}: given twice, or the name of an estimator")
            made[path] = create(load_network(path)[0].model, rate_hz, weights=path)
        return made
