"""The small dataset, and a copy that may be damaged."""

import subprocess
from pathlib import Path

import pytest
from small_dataset import CONFIG, DURATION, FLIGHTS

from quadsim.dataset import reading
from quadsim.dataset.generation import generate


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(CONFIG, FLIGHTS, DURATION, tmp_path_factory.mktemp("data") / "x.zarr", workers=1)


@pytest.fixture
def own(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy that a test may damage, and a cache of its own for what has been verified."""
    monkeypatch.setattr(reading, "user_cache_dir", lambda name: str(tmp_path / "cache"))
    subprocess.run(["cp", "-r", str(finished), str(tmp_path)], check=True)
    return tmp_path / "x.zarr"
