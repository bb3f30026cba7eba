"""Datasets of labelled flights in xarray and Zarr: generation from recipes, checks, figures and export."""

from .generation import generate
from .reading import dataset_info, open_dataset, verify

__all__ = ["dataset_info", "generate", "open_dataset", "verify"]
