"""Stamps of pages: what makes a page out of date, and what does not."""

import importlib.util
import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure

DOCS = Path(__file__).parents[1] / "docs"

TOML = """
ignored = ["docs/report.py"]

[page.one]
command = "python docs/one.py"
makes = ["docs/one.md", "docs/img/one.png"]
code = ["docs/one.py"]
files = ["assets/*.safetensors", "docs/one.template.md"]

[page.old]
command = "python docs/old.py"
makes = ["docs/old.md"]
code = ["docs/old.py"]
archived = "takes a night"
made_at = "0123abc"
"""
THING = '''"""A module."""


def double(x):
    """Twice x."""
    return 2 * x  # twice
'''


def load(name: str):
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def pages():
    yield load("pages")
    del sys.modules["pages"]


@pytest.fixture
def root(tmp_path, pages):
    """A project with a page that was made just now, and an archived one."""
    for folder in ("docs/img", "assets", "box", "other"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "docs/pages.toml").write_text(TOML)
    (tmp_path / "docs/one.py").write_text("def main():\n    from box.thing import double\n")
    (tmp_path / "docs/old.py").write_text("import other.thing\n")
    (tmp_path / "docs/report.py").write_text("print(1)\n")
    (tmp_path / "docs/one.template.md").write_text("# One\n\n{text}: D(x, d), {rows}\n")
    (tmp_path / "docs/old.md").write_text(pages.NOTICE.format(made_at="0123abc") + "\n\n# Old\n")
    (tmp_path / "box/__init__.py").write_text("")
    (tmp_path / "box/thing.py").write_text(THING)
    (tmp_path / "other/thing.py").write_text("x = 1\n")
    (tmp_path / "assets/a.safetensors").write_bytes(b"weights")
    page = pages.load_pages(tmp_path)["one"]
    page.save(Figure(), "one.png")
    page.write({"text": "half", "rows": ["a", "b"]})
    return tmp_path


def found(pages, root: Path) -> list[str]:
    return [line for _, line in pages.problems(pages.load_pages(root))]


def test_a_page_that_was_just_made_is_up_to_date(pages, root):
    assert found(pages, root) == []
    text = (root / "docs/one.md").read_text()
    assert text.startswith("# One\n\nhalf: D(x, d), a\nb\n")
    assert pages.STAMP.search(text.splitlines()[-1])["command"] == "python docs/one.py"


def test_changed_weights_make_a_page_and_its_figures_out_of_date(pages, root):
    (root / "assets/a.safetensors").write_bytes(b"others")
    expected = "docs/one.md, docs/img/one.png: out of date (assets/a.safetensors); python docs/one.py"
    assert found(pages, root) == [expected]


def test_further_weights_make_a_page_out_of_date(pages, root):
    (root / "assets/b.safetensors").write_bytes(b"more")
    assert "assets/b.safetensors" in found(pages, root)[0]


def test_comments_docstrings_and_formatting_do_not(pages, root):
    changed = "# new\ndef double(\n    x,\n):\n    '''Two times x.'''\n    return (2 * x)\n"
    (root / "box/thing.py").write_text(changed)
    assert found(pages, root) == []


def test_code_that_a_script_imports_in_a_function_does(pages, root):
    (root / "box/thing.py").write_text(THING.replace("2 * x", "3 * x"))
    assert "(box/thing.py)" in found(pages, root)[0]


def test_code_that_it_does_not_import_does_not(pages, root):
    (root / "other/thing.py").write_text("x = 2\n")
    (root / "docs/report.py").write_text("print(2)\n")
    assert found(pages, root) == []


def test_a_page_or_figure_without_its_stamp_is_out_of_date(pages, root):
    page = (root / "docs/one.md").read_text()
    (root / "docs/one.md").write_text(page[: page.index("<!--")])
    Figure().savefig(root / "docs/img/one.png")
    assert "docs/one.md, docs/img/one.png: out of date" in found(pages, root)[0]


def test_a_video_has_its_stamp_among_its_metadata(pages, tmp_path):
    path = tmp_path / "flight.mp4"
    path.write_bytes(b"\x00\x01moov\xff" + b"made by: python docs/one.py; digest 0123abc" + b"\x00\xa9mdat")
    assert pages.read_stamp(path) == "0123abc"


def test_an_archived_page_is_listed_and_no_problem_as_long_as_it_says_so(pages, root):
    assert list(pages.archived(pages.load_pages(root))) == ["docs/old.md: archived: takes a night"]
    (root / "docs/old.md").write_text("# Old\n")
    assert "docs/old.md: out of date" in found(pages, root)[0]


def test_a_block_of_a_page_is_replaced_and_stamped(pages, root):
    readme = root / "docs/one.md"
    readme.write_text("before\n<!-- table -->\nold\n<!-- made by: x; digest 00 -->\nafter\n")
    page = pages.load_pages(root)["one"]
    page.write_block(readme, "table", ["new"])
    assert readme.read_text() == f"before\n<!-- table -->\n\nnew\n\n<!-- {page.stamp} -->\nafter\n"
    assert found(pages, root) == []
    with pytest.raises(ValueError, match="no block"):
        page.write_block(readme, "other", ["new"])


def test_a_part_without_a_key_is_refused(pages, root):
    with pytest.raises(ValueError, match=r"one\.template\.md: rows, tail: key or part alone"):
        pages.load_pages(root)["one"].write({"text": "", "tail": ""})


def test_a_pattern_that_fits_no_file_is_refused(pages, root):
    (root / "assets/a.safetensors").unlink()
    with pytest.raises(ValueError, match=r"one: assets/\*\.safetensors: no such file"):
        found(pages, root)


def test_every_page_of_the_project_names_files_that_there_are(pages):
    for page in pages.load_pages().values():
        assert page.digest
        assert page.made
        script = (pages.ROOT / page.entry.command.removeprefix("python ")).name
        assert any(path.endswith(script) for path in page.inputs)


def test_pages_that_train_nothing_do_not_depend_on_the_training(pages):
    inputs = {name: page.inputs for name, page in pages.load_pages().items()}
    of_training = {name for name, files in inputs.items() if "training/config.py" in files}
    assert of_training == {"training", "paper"}
