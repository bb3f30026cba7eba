"""Notebooks of the tutorials: of the current text, readable without running, and they run."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
pytest.importorskip("nbclient")
DOCS = Path(__file__).parents[1] / "docs"
NAMES = ("data", "add", "estimator")
ABSOLUTE = re.compile(r"(?<![\w.])/(tmp|home|root|work|usr|opt|var|Users)/")
LARGEST_KB = 200


@pytest.fixture(scope="module")
def notebooks():
    spec = importlib.util.spec_from_file_location("notebooks", DOCS / "notebooks.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["notebooks"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["notebooks"]


@pytest.fixture(params=NAMES)
def name(request):
    return request.param


def test_a_notebook_has_the_text_of_its_tutorial(notebooks, name):
    """If not: python docs/notebooks.py."""
    assert sources(committed(name)) == sources(notebooks.notebook(name))


def test_a_changed_tutorial_is_noticed(notebooks, name, tmp_path, monkeypatch):
    text = (DOCS / "tutorials" / f"{name}.md").read_text("utf-8")
    (tmp_path / f"{name}.md").write_text(text.replace("quadsim ", "quadsim  ", 1), "utf-8")
    before = sources(committed(name))
    monkeypatch.setattr(notebooks, "FOLDER", tmp_path)
    assert before != sources(notebooks.notebook(name))


def test_its_commands_have_outputs_without_absolute_paths(notebooks, name):
    cells = [cell for cell in committed(name).cells if cell.cell_type == "code"]
    assert all(cell.outputs for cell in cells if cell.source.startswith("%%bash") or "print(" in cell.source)
    printed = "".join(each.get("text", "") for cell in cells for each in cell.outputs)
    assert not ABSOLUTE.search(printed)
    assert (DOCS / "tutorials" / f"{name}.ipynb").stat().st_size < LARGEST_KB * 1024


@pytest.mark.slow
def test_a_notebook_runs(notebooks, name):
    book = notebooks.executed(notebooks.notebook(name))
    shown = [len(cell.outputs) for cell in book.cells if cell.cell_type == "code"]
    assert shown == [len(cell.outputs) for cell in committed(name).cells if cell.cell_type == "code"]


def committed(name):
    return nbformat.read(DOCS / "tutorials" / f"{name}.ipynb", as_version=4)


def sources(book):
    """Kind and text of each cell."""
    return [(cell.cell_type, cell.source) for cell in book.cells]
