"""A source archive makes a wheel that holds everything, and runs from any folder."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("quadsim", "estimators", "training", "scenarios", "paper", "assets")
SCENARIO = """description = "Hover, one second."
duration_s = 1.0
"""


def run(command, folder, **variables):
    """Output of a command in a folder, without the repository on Python's path."""
    env = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"} | variables
    done = subprocess.run(
        list(map(str, command)), cwd=folder, env=env, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, f"{done.stdout[-1000:]}\n{done.stderr[-2000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel that was made of the source archive."""
    folder = tmp_path_factory.mktemp("dist")
    tracked = run(["git", "ls-files", "-z"], ROOT).split("\0")
    for name in filter(None, tracked):
        if (ROOT / name).is_file() and not name.startswith(("tests/", "docs/img/")):
            target = folder / "source" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes((ROOT / name).read_bytes())
    build = "import setuptools.build_meta as m; m.{}({!r})"
    run([sys.executable, "-c", build.format("build_sdist", str(folder))], folder / "source")
    (archive,) = folder.glob("quadsim-*.tar.gz")
    run(["tar", "xzf", archive], folder)
    (unpacked,) = (path for path in folder.glob("quadsim-*") if path.is_dir())
    run([sys.executable, "-c", build.format("build_wheel", str(folder))], unpacked)
    (made,) = folder.glob("quadsim-*.whl")
    return made


@pytest.mark.slow
def test_every_file_of_the_packages_is_in_the_wheel(wheel):
    tracked = run(["git", "ls-files", "-z", *PACKAGES], ROOT).split("\0")
    expected = {name for name in filter(None, tracked) if (ROOT / name).is_file()}
    assert expected <= set(zipfile.ZipFile(wheel).namelist())


@pytest.mark.slow
def test_an_installed_wheel_flies_beside_a_scenarios_folder_of_the_users(wheel, tmp_path):
    site, work = tmp_path / "site", tmp_path / "work"
    zipfile.ZipFile(wheel).extractall(site)
    (work / "scenarios").mkdir(parents=True)
    (work / "scenarios" / "mine.toml").write_text(SCENARIO)
    program = "import quadsim, sys; from quadsim.cli import main; print(quadsim.__file__); main()"
    for flags in ([], ["-P"]):  # with the folder itself on Python's path, and without
        command = [sys.executable, *flags, "-c", program]
        listed = run([*command, "list", "scenarios"], work, PYTHONPATH=str(site))
        assert str(site) in listed
        assert "scenarios/mine.toml" in listed
        for scenario in ("scenarios/mine.toml", "hover"):
            fly = [
                *command,
                "fly",
                scenario,
                "--estimator",
                "mahony",
                "--duration",
                0.5,
                "--out",
                f"{scenario}-{flags}",
            ]
            assert "0 of 1 crashed" in run(fly, work, PYTHONPATH=str(site))
