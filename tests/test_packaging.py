"""A source archive makes a wheel that holds everything; an installation runs from any folder."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from quadsim.runs.compiled import BESIDE, CacheFolder, store

ROOT = Path(__file__).parents[1]
PACKAGES = ("quadsim", "estimators", "training", "scenarios", "paper", "assets")
SHADOW = "raise ImportError('a folder of the user hides a package')"
SCENARIO = """description = "Hover, one second."
duration_s = 1.0
"""


COMMANDS = """
import shlex, sys
import quadsim
from quadsim.cli import main
print(quadsim.__file__)
for line in sys.argv[1:]:
    sys.argv = shlex.split(f"quadsim {line}")
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
"""
"""A program that runs command lines of quadsim one after the other."""


def fill_with_shadows(work, regular):
    """Give a working directory folders that are called as the packages; regular ones cannot be imported."""
    for name in PACKAGES:
        (work / name).mkdir(parents=True, exist_ok=True)
        if regular and name != "quadsim":  # Python itself decides which of those it begins with
            (work / name / "__init__.py").write_text(SHADOW)
    vehicle = (ROOT / "assets" / "vehicles" / "hummingbird.toml").read_text()
    (work / "assets" / "vehicles").mkdir(exist_ok=True)
    heavy = vehicle.replace("mass = 0.716", "mass = 0.9")
    assert heavy != vehicle
    (work / "assets" / "vehicles" / "hummingbird.toml").write_text(heavy)


def copy_compiled(code):
    """Fill an installation's folder for compiled code with ours: what was copied is not compiled again."""
    for inside in {file.parent for package in PACKAGES for file in (ROOT / package).rglob("*.py")}:
        name = "-".join(inside.relative_to(ROOT).parts)
        ours = name if store() == BESIDE else CacheFolder.get_suitable_cache_subpath(str(inside / "any.py"))
        if (store() / ours).is_dir():
            shutil.copytree(store() / ours, code / name)


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
    folder = tmp_path_factory.mktemp("dist")
    tracked = run(["git", "ls-files", "-z"], ROOT).split("\0")
    for name in filter(None, tracked):
        if (ROOT / name).is_file() and not name.startswith(("tests/", "docs/img/")):
            target = folder / "source" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes((ROOT / name).read_bytes())
    run([sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, folder / "source"], folder)
    (made,) = folder.glob("quadsim-*.whl")
    return made


@pytest.mark.slow
def test_every_file_of_the_packages_is_in_the_wheel(wheel):
    tracked = run(["git", "ls-files", "-z", *PACKAGES], ROOT).split("\0")
    expected = {name for name in filter(None, tracked) if (ROOT / name).is_file()}
    assert expected <= set(zipfile.ZipFile(wheel).namelist())


@pytest.mark.slow
def test_an_installed_wheel_flies_beside_folders_of_the_user_with_its_packages_names(wheel, tmp_path):
    site, work = tmp_path / "site", tmp_path / "work"
    zipfile.ZipFile(wheel).extractall(site)
    fill_with_shadows(work, regular=True)
    (work / "scenarios" / "mine.toml").write_text(SCENARIO)
    copy_compiled(code := site / BESIDE.relative_to(ROOT))
    variables = {"PYTHONPATH": str(site), "NUMBA_CACHE_DIR": str(code)}
    fly = "fly scenarios/mine.toml --estimator truth --out mine"
    for flags in ([], ["-P"]):  # with the folder itself on Python's path, and without
        commands = ["list scenarios", *[fly] * (flags == ["-P"])]
        done = run([sys.executable, *flags, "-c", COMMANDS, *commands], work, **variables)
        assert str(site) in done
        assert "scenarios/mine.toml" in done
    assert "0 of 1 flight crashed" in done


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    """The programs of a virtual environment with an editable installation."""
    folder = tmp_path_factory.mktemp("editable")
    venv.create(folder / "venv", with_pip=False, symlinks=True)
    (site,) = folder.glob("venv/lib/python*/site-packages")
    build = f"import setuptools.build_meta as m; m.build_editable({str(folder)!r})"
    run([sys.executable, "-c", build], ROOT)
    (made,) = folder.glob("quadsim-*.whl")
    zipfile.ZipFile(made).extractall(site)
    (site / "others.pth").write_text(sysconfig.get_path("purelib"))  # whose own .pth files are not read
    program = folder / "venv" / "bin" / "quadsim"  # as pip makes it
    program.write_text(
        f"#!{program.parent}/python\nfrom quadsim.cli import main\nif __name__ == '__main__':\n    main()\n"
    )
    program.chmod(0o755)
    return program.parent


MASS = """
import quadsim.vehicle
import estimators, paper, scenarios, training
print(quadsim.vehicle.load_vehicle("hummingbird").mass)
print(*(each.__file__ for each in (estimators, paper, quadsim, scenarios, training)))
"""


@pytest.mark.slow
@pytest.mark.parametrize("regular", [False, True], ids=["namespace", "regular"])
def test_folders_of_the_user_hide_no_package_of_an_editable_installation(programs, tmp_path, regular):
    fill_with_shadows(tmp_path, regular)
    program = [programs / "quadsim"] if regular else [programs / "python", "-m", "quadsim.cli"]
    cells = ["--scenario", "hover", "--estimator", "mahony", "--estimator", "truth", "--seeds", "1"]
    done = run([*program, "bench", *cells, "--duration", "0.2", "--workers", "2", "--out", "out"], tmp_path)
    assert "mahony" in done
    assert "did not run" not in done
    mass, *files = run([programs / "python", "-c", MASS], tmp_path).split()
    assert mass == "0.716"
    assert files == [str(ROOT / name / "__init__.py") for name in sorted(PACKAGES) if name != "assets"]


@pytest.mark.slow
def test_an_editable_installation_is_found_before_empty_folders_of_the_user(programs, tmp_path):
    fill_with_shadows(tmp_path, regular=False)
    for name in PACKAGES:  # each imported first
        program = f"import {name}; print({name}.__file__)"
        assert run([programs / "python", "-c", program], tmp_path).strip() == str(ROOT / name / "__init__.py")


def test_shipped_files_are_found_although_a_package_of_the_user_was_imported_first(tmp_path):
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "__init__.py").write_text("")
    program = "import assets, quadsim.vehicle as v; print(v.load_vehicle('hummingbird').mass)"
    assert run([sys.executable, "-c", program], tmp_path, PYTHONPATH=f"{tmp_path}:{ROOT}").strip() == "0.716"


def test_without_pytorch_all_but_training_runs_and_training_names_the_extra(tmp_path):
    (tmp_path / "torch.py").write_text("raise ModuleNotFoundError(\"No module named 'torch'\", name='torch')")
    networks = "--estimator att-snn --estimator att-rnn --estimator att-snn-loihi"
    commands = [
        "generate --recipe hummingbird --flights 2 --duration 1 --workers 1 --out flights.zarr",
        f"evaluate --data flights.zarr {networks} --out scores",
        "fly hover --estimator att-snn-loihi --duration 0.2 --out flight",
        "train --data flights.zarr --out snn",
    ]
    env = os.environ | {"PYTHONPATH": f"{tmp_path}:{ROOT}"}
    command = [sys.executable, "-c", COMMANDS, *commands]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.endswith('quadsim: the package torch is missing: pip install "quadsim[train]"\n')
    assert all((tmp_path / name).exists() for name in ("scores", "flight"))
