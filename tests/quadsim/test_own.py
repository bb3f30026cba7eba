"""Objects of a user's code by name."""

import importlib
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from own_estimator import MINE

import estimators
from quadsim import own as own_code
from quadsim.own import load_own, own_files

SOURCE = f"import neighbour_of_mine\n{MINE}"


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "neighbour_of_mine.py").write_text("")
    path = tmp_path / "mine.py"
    path.write_text(SOURCE)
    yield path
    sys.modules.pop("neighbour_of_mine", None)


def test_a_class_of_a_file_is_loaded_with_its_neighbours(file):
    assert load_own("mine.py:Mine").__name__ == "Mine"
    assert load_own(f"{file}:Mine.Inner").__name__ == "Inner"
    assert file in own_files("mine.py:Mine")


GAIN = "from {} import GAIN\nclass Mine:\n    gain = GAIN\n"


@pytest.fixture
def user(tmp_path, monkeypatch):
    """Writes files into a working directory that is on Python's path, as the command line puts it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, ""])
    before = set(sys.modules)

    def write(files):
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)

    yield write
    for name in set(sys.modules) - before:
        del sys.modules[name]


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("code/est.py:Mine", {"code/est.py": GAIN.format("gains_x"), "code/gains_x.py": "GAIN = 1"}),
        ("code/est.py:Mine", {"code/est.py": GAIN.format("lib_x.gains"), "lib_x/gains.py": "GAIN = 1"}),
        ("code/est.py:Mine", {"code/est.py": "GAIN = 1\nclass Mine:\n    gain = GAIN\n"}),
        (
            "code/est.py:Mine",
            {
                "code/est.py": GAIN.format("a_x"),
                "code/a_x.py": "from b_x import GAIN",
                "code/b_x.py": "GAIN = 1",
            },
        ),
        (
            "pkg_x.inner.est:Mine",
            {
                "pkg_x/__init__.py": "",
                "pkg_x/inner/__init__.py": "",
                "pkg_x/inner/est.py": GAIN.format("..gains"),
                "pkg_x/gains.py": "GAIN = 1",
            },
        ),
        ("space_x.est:Mine", {"space_x/est.py": GAIN.format("space_x.a"), "space_x/a.py": "GAIN = 1"}),
        ("space_x.est:Mine", {"space_x/est.py": GAIN.format(".a"), "space_x/a.py": "GAIN = 1"}),
    ],
)
def test_a_file_that_the_users_code_imports_belongs_to_it_and_is_loaded_anew(user, tmp_path, name, files):
    user(files)
    assert [file.resolve() for file in own_files(name)] == sorted(tmp_path / each for each in files)
    before = load_own(name)
    assert before.gain == 1
    assert load_own(name) is before
    user({file: text.replace("GAIN = 1", "GAIN = 2") for file, text in files.items()})
    assert load_own(name).gain == 2


def test_files_of_the_product_and_of_other_packages_are_not_the_users(user, tmp_path):
    package = own_files("pydantic.main:BaseModel")
    assert {file.parts[file.parts.index("site-packages") + 1] for file in package} == {"pydantic"}
    imports = "import json, numpy, estimators\nfrom quadsim.own import load_own"
    user({"est.py": imports, "json.py": "", "bad.py": "("})
    assert own_files("est.py:Mine") == [tmp_path / "est.py", tmp_path / "json.py"]
    assert own_files("bad.py:Mine") == [tmp_path / "bad.py"]


def test_neighbours_of_one_name_in_two_folders_are_two_modules(user):
    for folder in ("one", "two"):
        user({f"{folder}/est.py": GAIN.format("gains_y"), f"{folder}/gains_y.py": f"GAIN = '{folder}'"})
    assert [load_own(f"{folder}/est.py:Mine").gain for folder in ("one", "two")] == ["one", "two"]


def test_a_neighbour_that_was_imported_and_then_changed_is_loaded_as_it_is(user, tmp_path, monkeypatch):
    user({"est.py": GAIN.format("gains_z"), "gains_z.py": "GAIN = 1"})
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    importlib.import_module("gains_z")
    user({"gains_z.py": "GAIN = 2"})
    assert load_own("est.py:Mine").gain == 2


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("mine.py:Min", "has no Min; .*Mine"),
        ("nothing.py:Mine", "there is no file"),
        ("no_such_module:Mine", "No module named"),
        ("mine.py:", "should be package.module:Name"),
        ("bad.py:Mine", "SyntaxError"),
        ("exits.py:Mine", "SystemExit"),
    ],
)
def test_what_cannot_be_loaded_is_said_in_one_line(file, name, text):
    file.with_name("bad.py").write_text("def")
    file.with_name("exits.py").write_text("raise SystemExit(3)")
    with pytest.raises(ValueError, match=text) as error:
        load_own(name)
    assert "\n" not in str(error.value)


def test_an_entry_point_is_a_name_as_well(file, monkeypatch):
    point = SimpleNamespace(value="mine.py:Mine")
    monkeypatch.setattr(own_code, "entry_points_of", lambda group: {"mine": point} if group else {})
    assert estimators.create("mine").gain == 0.02


def test_declared_parameters_are_given_tuned_and_read_from_a_file(file):
    name = "mine.py:Mine"
    assert list(estimators.parameters(name)) == ["gain"]
    assert estimators.create(name, gain=0.1).gain == 0.1
    with pytest.raises(ValueError, match="gian"):
        estimators.create(name, gian=0.1)
    table = f'["{name}"]\ncommand = "by hand"\nrate_hz = 200\nrmse_deg = 1.0\nevaluations = 1\n'
    file.with_name("tuned.toml").write_text(f"{table}values = {{ gain = 0.25 }}\n")
    assert estimators.create(name, tuning="tuned.toml").gain == 0.25
    gyro, accel = np.zeros((1, 50, 3)), np.tile([0.0, 2.0, 9.6], (1, 50, 1))
    slow, fast = estimators.run_batch(name, {"gain": [0.01, 0.3]}, gyro, accel)
    assert fast[0, -1, 0] > 2 * slow[0, -1, 0]


def test_a_class_that_is_fed_the_truth_is_given_it_before_its_first_update(file):
    source = "\n\nclass Peek(Mine):\n    def observe(self, quat):\n        self.truth = quat[:, 1:3]\n"
    file.write_text(SOURCE + source + "\n    def update(self, gyro, accel):\n        return self.truth\n")
    assert estimators.create("mine.py:Peek").truth.shape == (3, 2)


@pytest.mark.parametrize("where", ["__init__(self, rate_hz, gain=0.02)", "update(self, gyro, accel)"])
def test_a_class_that_ends_the_process_is_said_in_one_line(file, where):
    file.write_text(SOURCE + f"\n\nclass Exits(Mine):\n    def {where}:\n        raise SystemExit(0)\n")
    with pytest.raises(ValueError, match=r"mine.py:Exits.* SystemExit: 0"):
        estimators.create("mine.py:Exits")
