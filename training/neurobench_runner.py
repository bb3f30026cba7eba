"""Adapters for NeuroBench's runner: a model of any estimator, and an error metric.

    loader = DataLoader(Windows("data/test.zarr", steps=2000), batch_size=16)
    Benchmark(EstimatorModel(create("att-snn")), loader, [], [], [[Footprint], [InclinationRmse]]).run()

For your own PyTorch network, use NeuroBench's `TorchModel` instead of `EstimatorModel`; NeuroBench then
counts its operations. NeuroBench is described by Yik et al., Nature Communications 16:1545, 2025.
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
    """An estimator, which starts from an unknown attitude in every window."""

    def __init__(self, estimator: AttitudeEstimator) -> None:
        super().__init__()
        self.estimator = estimator

    def __call__(self, batch: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return roll and pitch (n, steps, 2) [rad] for readings (n, steps, 6)."""
        readings = batch.numpy().astype(float)
        return torch.from_numpy(run(self.estimator, readings[..., :3], readings[..., 3:])).float()

    def __net__(self) -> nn.Module:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the estimator if it is a PyTorch module; otherwise a module without parameters."""
        return self.estimator if isinstance(self.estimator, nn.Module) else nn.Module()


class InclinationRmse(WorkloadMetric):
    """RMS inclination error of each window, averaged over windows [deg]."""

    def __call__(self, model: Any, preds: Tensor, data: tuple[Tensor, Tensor]) -> float:
        """Compute the error; see `estimators.metrics.inclination_rmse`."""
        return inclination_rmse(preds.numpy(), data[1].numpy()).mean
