"""What NeuroBench's own runner needs for attitude: a model of any estimator, and an error.

    loader = DataLoader(Windows("data/test.zarr", steps=2000), batch_size=16)
    Benchmark(EstimatorModel(create("att-snn")), loader, [], [], [[Footprint], [InclinationRmse]]).run()

A network of yours in PyTorch goes into NeuroBench's `TorchModel` in place of `EstimatorModel`, and NeuroBench
counts its operations. NeuroBench: Yik et al., Nature Communications 16:1545, 2025.
"""

from __future__ import annotations

from typing import Any

import torch
from neurobench.metrics.abstract.workload_metric import WorkloadMetric  # pyright: ignore[reportMissingImports]
from neurobench.models import NeuroBenchModel  # pyright: ignore[reportMissingImports]
from torch import Tensor, nn

from estimators.metrics import inclination_rmse
from estimators.running import run
from quadsim.estimator import AttitudeEstimator


class EstimatorModel(NeuroBenchModel):
    """An estimator, from an unknown start in every window; a filter has no layers to count."""

    def __init__(self, estimator: AttitudeEstimator) -> None:
        super().__init__()
        self.estimator = estimator

    def __call__(self, batch: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Roll and pitch (n, steps, 2) [rad] of readings (n, steps, 6)."""
        readings = batch.numpy().astype(float)
        return torch.from_numpy(run(self.estimator, readings[..., :3], readings[..., 3:])).float()

    def __net__(self) -> nn.Module:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The estimator where it is a PyTorch module, else one without parameters."""
        return self.estimator if isinstance(self.estimator, nn.Module) else nn.Module()


class InclinationRmse(WorkloadMetric):
    """RMS of the inclination error of each window, mean over windows [deg]."""

    def __call__(self, model: Any, preds: Tensor, data: tuple[Tensor, Tensor]) -> float:
        """See `estimators.metrics.inclination_rmse`."""
        return inclination_rmse(preds.numpy(), data[1].numpy()).mean
