import json
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray as xr

from quadsim.dataset import store as dataset_store
from quadsim.dataset.export import FORMATS, export
from quadsim.dataset.figures import plot
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.dataset.store import VARIABLES, Recorded
from quadsim.flight.recipe import Recipe
from quadsim.flight.simulate import simulate_flights
from quadsim.imu.spec import load_imu
from quadsim.vehicle import load_vehicle

FLIGHTS, STEPS, ENDS = 3, 60, [60, 25, 60]
IMU = load_imu("adis16448").model_copy(
    update={"lever_arm": (0.01, 0.02, 0.03), "mounting_deg": (0.0, 0.0, 90.0)}
)
CONFIG = Recipe(vehicle=load_vehicle("hummingbird"), imu=IMU, warmup_s=0.0)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def ending_early(config, seeds, steps, rate_hz):
        log = simulate_flights(config, seeds, steps, rate_hz)
        log["end_step"][1], log["end_reason"][1] = ENDS[1], "hit the ground"
        return log

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dataset_store, "simulate_flights", ending_early)
        return generate(CONFIG, FLIGHTS, STEPS / 200, tmp_path_factory.mktemp("data") / "x.zarr", workers=1)


def flown(source: Path, flight: int) -> xr.Dataset:
    return open_dataset(source).isel(flight=flight, time=slice(ENDS[flight]))


def test_netcdf_holds_the_whole_dataset(source, tmp_path):
    out = export(source, tmp_path / "x.nc", "netcdf")
    with xr.open_dataset(out, engine="h5netcdf") as found:
        xr.testing.assert_identical(found.load(), open_dataset(source).load())


def test_what_no_log_of_a_recorded_dataset_holds_is_nan(source, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    config = Recorded(logs=("a",), piece_s=1.0, unknown=("position", "gyro_bias"))._asdict()
    dataset = open_dataset(source).assign_attrs(config=json.dumps(config))
    FORMATS["parquet"](dataset, tmp_path / "out", lambda *done: None)
    table = parquet.ParquetFile(tmp_path / "out").read_row_group(0)
    assert np.isnan(table["position_x"]).all()
    assert np.isfinite(table["gyro_x"]).all()


def test_a_hugging_face_folder_has_a_card_and_the_table(source, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    folder = export(source, tmp_path / "hub", "huggingface")
    card = (folder / "README.md").read_text()
    file = card.split("data_files: ")[1].split()[0]
    table = parquet.ParquetFile(folder / file)
    assert table.metadata.num_rows == sum(ENDS)
    assert card.startswith("---\npretty_name:")
    for name in table.schema_arrow.names:
        assert f"`{name}`" in card
    assert json.loads(card.split("```json")[1].split("```")[0])["vehicle"]["name"] == "hummingbird"


def test_parquet_holds_every_sample_flown_as_a_row_with_units(source, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    file = parquet.ParquetFile(export(source, tmp_path / "x.parquet", "parquet"))
    assert file.num_row_groups == FLIGHTS
    assert file.schema_arrow.field("accel_z").metadata[b"units"] == b"m/s^2"
    assert json.loads(file.schema_arrow.metadata[b"config"]) == CONFIG.model_dump(mode="json")
    for flight in range(FLIGHTS):
        table, truth = file.read_row_group(flight), flown(source, flight)
        assert set(table["flight"].to_pylist()) == {flight}
        assert np.array_equal(table["time"], truth["time"])
        for name, variable in VARIABLES.items():
            columns = [table[f"{name}_{label}"] for label in truth[variable.dim].to_numpy()]
            assert np.array_equal(np.stack(columns, axis=-1), truth[name])


@pytest.mark.parametrize("format", FORMATS)
def test_progress_ends_with_the_last_flight(source, tmp_path, format):
    calls = []
    export(source, tmp_path / "out", format, progress=lambda *done: calls.append(done))
    assert calls[-1] == (FLIGHTS, FLIGHTS)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize(
    ("out", "format", "error", "text"),
    [
        (
            "x",
            "netcfd",
            ValueError,
            r'unknown format "netcfd"; did you mean "netcdf"\? valid: netcdf',
        ),
        ("thesis", "parquet", ValueError, "exists already"),
        ("thesis/x.nc", "netcdf", OSError, r"cannot write .*/thesis/x.nc: "),
    ],
)
def test_a_format_or_a_place_that_is_none_is_one_clear_line(source, tmp_path, out, format, error, text):
    (tmp_path / "thesis").write_text("chapter 1")
    with pytest.raises(error, match=text):
        export(source, tmp_path / out, format)
    assert (tmp_path / "thesis").read_text() == "chapter 1"


def test_a_picture_has_ink_in_every_part(source, tmp_path):
    picture = imageio.imread(plot(source, tmp_path / "new" / "x.png"))[..., :3]
    assert picture.shape[0] > 1000
    assert picture.shape[1] > 1000
    parts = [part for row in np.array_split(picture, 5) for part in np.array_split(row, 4, axis=1)]
    assert all(np.ptp(part) > 100 for part in parts)
