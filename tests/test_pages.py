"""Stamps of pages: what `make check` refuses, and what it lists as old."""

import sys
from importlib import import_module
from pathlib import Path

import pytest
from matplotlib.figure import Figure

DOCS = Path(__file__).parents[1] / "docs"
THING = '"""A module."""\n\n\ndef double(x):\n    """Twice x."""\n    return 2 * x  # twice\n'


@pytest.fixture(scope="module")
def pages():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS)
        yield import_module("pages")
    del sys.modules["pages"]


@pytest.fixture
def page(tmp_path, pages):
    """A page that was made just now, in a project of its own."""
    for folder in ("docs/img", "assets/weights", "box", "other"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "docs/speed.py").write_text("def values():\n    from box.thing import double\n")
    (tmp_path / "docs/speed.template.md").write_text("# One\n\n{text}: D(x, d), {rows}\n![](img/one.png)\n")
    (tmp_path / "box/__init__.py").write_text("")
    (tmp_path / "box/thing.py").write_text(THING)
    (tmp_path / "other/thing.py").write_text("x = 1\n")
    (tmp_path / "assets/weights/a.safetensors").write_bytes(b"weights")
    page = pages.Page("speed", tmp_path)
    page.save(Figure(), "one.png")
    page.write({"text": "half", "rows": ["a", "b"]})
    return page


def test_a_page_ends_with_its_command_and_the_commit_that_made_it(pages, page, capsys):
    text = page.path.read_text()
    assert text.startswith("# One\n\nhalf: D(x, d), a\nb\n")
    stamp = pages.STAMP.fullmatch(text.splitlines(keepends=True)[-1])
    assert stamp["command"] == "python docs/pages.py speed"
    assert len(stamp["commit"]) >= 7
    assert (pages.check([page]), capsys.readouterr().out) == ([], "")
    with pytest.raises(ValueError, match=r"speed\.template\.md: rows, tail: key or part alone"):
        page.write({"text": "", "tail": ""})
    page.path.write_text("# One\n")
    assert pages.check([page]) == ["speed.md: edited since it was made; python docs/pages.py speed"]
    with pytest.raises(ValueError, match=r"speed\.md: no stamp"):
        page.restamp()


@pytest.mark.parametrize("file", ["docs/speed.md", "docs/img/one.png"])
def test_a_page_or_picture_that_was_edited_is_refused_until_it_is_stamped(pages, page, file, capsys):
    path = page.root / file
    path.write_bytes(path.read_bytes().replace(b"half", b"hole") + b" ")
    if file.endswith(".md"):
        path.write_text(path.read_text().removesuffix(" "))
    assert pages.check([page]) == ["speed.md: edited since it was made; python docs/pages.py speed"]
    page.restamp()
    assert pages.check([page]) == []
    assert "the code has changed" not in page.path.read_text()


@pytest.mark.parametrize(
    ("file", "content", "older"),
    [
        ("assets/weights/a.safetensors", "others", True),
        ("assets/weights/b.safetensors", "more", True),
        ("docs/speed.template.md", "# Two\n", True),
        ("box/thing.py", THING.replace("2 * x", "3 * x"), True),
        ("box/thing.py", "# new\ndef double(\n    x,\n):\n    '''Two times.'''\n    return (2 * x)\n", False),
        ("other/thing.py", "x = 2\n", False),
    ],
)
def test_a_page_whose_code_or_assets_changed_is_listed_and_no_failure(
    pages, page, file, content, older, capsys
):
    (page.root / file).write_text(content)
    assert pages.check([page]) == []
    assert ("speed.md: made at" in capsys.readouterr().out) == older
    before = pages.read_stamp(page.path)["commit"], pages.read_stamp(page.path)["code"]
    page.restamp()
    page.restamp()
    after = pages.read_stamp(page.path)
    assert (after["commit"], after["code"]) == before
    assert page.path.read_text().count(f"*Made at commit {before[0]}; the code has changed since.*") == older


def test_of_the_readme_the_part_between_the_mark_and_the_stamp_is_replaced(pages, tmp_path):
    page = pages.Page("README", tmp_path)
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/readme.py").write_text("x = 1\n")
    old = pages._stamp("x", "0", "0", "0")
    page.path.write_text(f"before\n{pages.BLOCK}old\n{old}after\n")
    page.write({"results": ["new", "rows"]})
    before, body, after = pages.split(page.path.read_text())
    assert (before, body, after) == (f"before\n{pages.BLOCK}", "\nnew\nrows\n\n", "after\n")
    page.path.write_text(page.path.read_text().replace("before", "changed"))
    assert pages.check([page]) == []


def test_every_page_has_a_script_and_no_page_was_edited(pages):
    assert pages.check([pages.Page(name) for name in pages.SCRIPTS]) == []
    for name in pages.SCRIPTS.values():
        assert "def values(page: Page, given: Namespace) -> Parts:" in (DOCS / f"{name}.py").read_text()
    with_template = {path.name.removesuffix(".template.md") for path in DOCS.glob("*.template.md")}
    assert with_template == pages.SCRIPTS.keys() - {"README"}
