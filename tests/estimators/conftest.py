"""Flights of a generated dataset."""

import pytest
from small_dataset import generated

from estimators.evaluation.flights import load_flights


@pytest.fixture(scope="session")
def hummingbird(tmp_path_factory):
    """Four flights of 30 s; no training uses their seed."""
    return load_flights([generated(tmp_path_factory.mktemp("hummingbird"), "hummingbird", 4, 30.0, 910_033)])
