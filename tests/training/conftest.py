import pytest

from quadsim.dataset.generation import generate
from quadsim.flight.recipe import load_recipe


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "tiny.zarr"
    config = load_recipe("hummingbird")
    return generate(config, flights=5, duration_s=4.0, out=path, seed=3, workers=1)
