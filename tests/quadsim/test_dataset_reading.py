"""Opening a dataset: what is not one, newer, edited, damaged or incomplete is refused; its summary."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from small_dataset import CONFIG, DURATION, FLIGHTS, STEPS, files

from quadsim.dataset import reading
from quadsim.dataset import store as dataset_store
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import dataset_info, open_dataset, verify
from quadsim.dataset.store import VARIABLES
from quadsim.flight.simulate import simulate_flights
from quadsim.rotation import roll_pitch_from_quat


def test_a_missing_path_says_what_makes_one(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such dataset; `quadsim generate --out"):
        open_dataset(tmp_path / "none.zarr")


def test_what_is_not_a_dataset_is_refused(tmp_path):
    (tmp_path / "file.zarr").write_text("not one")
    (tmp_path / "folder.zarr").mkdir()
    odd = {"format": "quadsim flights", "format_version": "one"}
    for name, attributes in (("other", {"title": "x"}), ("odd", odd)):
        (tmp_path / f"{name}.zarr").mkdir()
        (tmp_path / f"{name}.zarr" / "zarr.json").write_text(json.dumps({"attributes": attributes}))
    for path in tmp_path.iterdir():
        with pytest.raises(ValueError, match="is not a dataset of quadsim") as caught:
            open_dataset(path)
        assert "\n" not in str(caught.value)


def test_a_newer_format_is_refused(own):
    metadata = json.loads((own / "zarr.json").read_text())
    metadata["attributes"]["format_version"] = 2
    (own / "zarr.json").write_text(json.dumps(metadata))
    with pytest.raises(ValueError, match=r"format version 2, newer than the 1 .*update quadsim"):
        open_dataset(own)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("gyro/zarr.json", "rad/s", "deg/s"),
        ("zarr.json", "rad/s", "deg/s"),
        ("zarr.json", '\\"mass\\":0.716', '\\"mass\\":0.816'),
    ],
)
def test_an_edited_unit_or_configuration_is_refused(own, name, old, new):
    text = (own / name).read_text()
    assert old in text
    (own / name).write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=rf"{name} changed since it was written"):
        open_dataset(own)


@pytest.mark.parametrize(
    ("lost", "said"),
    [
        ("accel/c.5.0.0", "flight 5: accel is missing"),
        ("time/c/0", "time/c/0 is missing"),
        (dataset_store.DIGESTS, "No such file"),
    ],
)
def test_a_missing_file_is_found_on_opening(own, lost, said):
    (own / lost).unlink()
    with pytest.raises(ValueError, match=rf"x.zarr is damaged: .*{said}") as caught:
        open_dataset(own)
    assert "\n" not in str(caught.value)


def test_verify_names_the_damaged_flights(own):
    (own / "accel" / "c.1.0.0").unlink()
    os.truncate(own / "gyro" / "c.2.0.0", 100)
    gyro, velocity = own / "gyro" / "c.3.0.0", own / "velocity" / "c.3.0.0"
    content = {gyro: velocity.read_bytes(), velocity: gyro.read_bytes()}
    for file, others in content.items():
        file.write_bytes(others)
    changed = ", ".join(f"flight {flight}: a file changed since it was written" for flight in (2, 3))
    with pytest.raises(ValueError, match=f"damaged: flight 1: accel is missing, {changed}; copy"):
        verify(own)


def test_info_states_spread_over_all_samples(finished):
    info = dataset_info(finished)
    roll, pitch = np.degrees(roll_pitch_from_quat(open_dataset(finished)["quat"].to_numpy())).std((0, 1))
    assert info["roll_sd_deg"] == pytest.approx(roll, rel=1e-4)
    assert info["pitch_sd_deg"] == pytest.approx(pitch, rel=1e-4)
    assert info["samples"] == FLIGHTS * STEPS
    assert info["config"]["imu"] == CONFIG.imu.model_dump(mode="json")


def test_tilt_of_a_known_attitude(tmp_path, monkeypatch):
    def tilted(config, seeds, steps, rate_hz):
        log = simulate_flights(config, seeds, steps, rate_hz)
        log["quat"][:] = (np.cos(np.radians(20)), np.sin(np.radians(20)), 0, 0)
        return log

    monkeypatch.setattr(dataset_store, "simulate_flights", tilted)
    info = dataset_info(generate(CONFIG, 1, DURATION, tmp_path / "x.zarr", workers=1))
    assert info["max_tilt_deg"] == pytest.approx(40, abs=1e-3)
    assert info["roll_sd_deg"] == pytest.approx(0, abs=1e-3)


def flipped(file: Path, byte: int) -> None:
    """Flip a bit of a file, whose size and time stamp stay as they are."""
    before, content = file.stat(), bytearray(file.read_bytes())
    content[byte] ^= 4
    file.write_bytes(content)
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))


def test_a_flipped_bit_of_any_file_is_found_by_verify_whatever_the_time_stamps(own):
    open_dataset(own)
    names = [name for name in files(own) if not name.endswith("zarr.json") or name == "zarr.json"]
    names = [name for name in names if "/c." not in name or "/c.3." in name]
    assert len(names) == len(VARIABLES) + 6 + 2  # no reason to end is no file
    for name in [*names, "gyro/zarr.json", "time/zarr.json"]:
        size = (own / name).stat().st_size
        for byte in (1, size // 2, size - 2):
            flipped(own / name, byte)
            with pytest.raises(ValueError, match=str(own)):
                verify(own)
            flipped(own / name, byte)
    assert verify(own) == FLIGHTS


def test_files_are_looked_at_once_and_again_when_one_changes(own, monkeypatch):
    looked = []
    monkeypatch.setattr(reading, "verify", looked.append)
    open_dataset(own)
    open_dataset(own)
    assert looked == [own]
    os.utime(dataset_store.chunk_file(own, "gyro", 2), ns=(0, 0))
    open_dataset(own)
    assert looked == [own, own]
