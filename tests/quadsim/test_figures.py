from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from quadsim.dataset.figures import plot
from quadsim.dataset.generation import generate
from quadsim.flight.recipe import Recipe
from quadsim.imu.spec import load_imu
from quadsim.vehicle import load_vehicle

CONFIG = Recipe(vehicle=load_vehicle("hummingbird"), imu=load_imu("adis16448"), warmup_s=0.5)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(CONFIG, 3, 1.0, tmp_path_factory.mktemp("data") / "x.zarr", workers=1)


def test_a_picture_has_ink_in_every_part(source, tmp_path):
    picture = imageio.imread(plot(source, tmp_path / "new" / "x.png"))[..., :3]
    assert picture.shape[0] > 1000
    assert picture.shape[1] > 1000
    parts = [part for row in np.array_split(picture, 5) for part in np.array_split(row, 4, axis=1)]
    assert all(np.ptp(part) > 100 for part in parts)


def test_an_unknown_picture_format_is_refused(source, tmp_path):
    with pytest.raises(ValueError, match="Format 'docx' is not supported"):
        plot(source, tmp_path / "x.docx")
