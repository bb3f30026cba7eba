"""The task of attitude estimators: windows of recorded flights, validation on complete ones."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from estimators.metrics import absolute_error, inclination_error
from estimators.networks.gru import Recurrent
from estimators.networks.network import NetworkEstimator, Spiking
from estimators.networks.weights_file import NetworkConfig, Tensors

from .config import TrainConfig
from .data import Batch, flights_of, network_inputs, sample_windows, windows
from .init import initialise_from_data, initialise_from_weights, initialise_random
from .models import AttRNN, AttSNN, new_att_snn

SETTLED_S = 5.0
"""Time after an unknown initial attitude that `settled_deg` leaves out [s]."""


class AttitudeTask:
    """Roll and pitch, or up, from readings of an IMU; see `training.loop.Task`."""

    scale = (1.0,)

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        self.flights, self.validation, _ = flights_of(config)
        self.rate_hz = self.flights.rate_hz

    def contents(self) -> dict[str, str]:
        """Digests of the flights."""
        return {"data": self.flights.digest(), "validation": self.validation.digest()}

    def initial_model(self) -> AttSNN | AttRNN:
        """The network before the first update."""
        config = self.config
        spiking = config.model == "att-snn"
        model = new_att_snn(config) if spiking else AttRNN(config.hidden, config.outputs)
        if config.init:
            initialise_from_weights(model, config.init)
        elif isinstance(model, AttSNN) and config.initialisation == "random":
            initialise_random(model, config.seed)
        elif isinstance(model, AttSNN):
            batch, steps = sample_windows(config, self.flights), config.steps_per_sample
            target = np.repeat(batch.target, steps, 1)
            initialise_from_data(model, network_inputs(config, batch).numpy(), target, config.seed, steps)
        return model

    def windows(self, epoch: int, student: Any) -> Iterator[Batch]:
        """The windows of an epoch; no student flies."""
        steps = self.config.steps_in(epoch, self.rate_hz)
        return windows(self.flights, self.config, steps, (self.config.seed, 1, epoch))

    def validate(self, network: NetworkConfig, tensors: Tensors) -> dict[str, float]:
        """Errors over complete validation flights, unknown initial attitude.

        `loss` chooses the best epoch: the mean square error [rad²]; of up half the mean square of the
        inclination error, which is the same for small tilts. `error_deg`: mean absolute error of roll and
        pitch; `settled_deg`: the same without the first 5 s; `inclination_deg`: RMS inclination error.
        """
        core = Spiking(network, tensors) if network.model == "att-snn" else Recurrent(network, tensors)
        estimator = NetworkEstimator(core, network.rate_hz)
        flights, truth = self.validation, self.validation.roll_pitch
        estimator.reset(len(flights))
        estimate = estimator.sequence(flights.gyro, flights.accel)
        error = absolute_error(estimate, truth)
        settled = error[:, round(SETTLED_S * flights.rate_hz) :]
        inclination = float(np.sqrt(np.mean(inclination_error(estimate, truth) ** 2)))
        up = network.outputs == "up"
        return {
            "loss": math.radians(inclination) ** 2 / 2 if up else float(np.mean((estimate - truth) ** 2)),
            "error_deg": float(error.mean()),
            "settled_deg": float((settled if settled.size else error).mean()),
            "inclination_deg": inclination,
        }

    def note(self) -> dict[str, Any]:
        """What the weights say of the flights."""
        sizes = {"training_flights": len(self.flights), "validation_flights": len(self.validation)}
        return {"vehicles": list(self.flights.vehicles)} | sizes
