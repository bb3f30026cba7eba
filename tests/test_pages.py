"""Stamps of measured parts: what `make check` refuses, and what it lists as old."""

from pathlib import Path

import pandas as pd
import pytest
from matplotlib.figure import Figure

DOCS = Path(__file__).parents[1] / "docs"
EDITED = "speed.md, part speed: edited since it was made; python docs/pages.py speed"
THING = '"""A module."""\n\n\ndef double(x):\n    """Twice x."""\n    return 2 * x  # twice\n'


@pytest.fixture(scope="module")
def pages(script):
    return script("pages")


@pytest.fixture
def part(tmp_path, pages):
    """A part that was made just now, in a project of its own."""
    for folder in ("docs/img", "docs/parts", "assets/weights", "box", "other"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "docs/speed.py").write_text("def values():\n    from box.thing import double\n")
    (tmp_path / "docs/parts/speed.md").write_text("{text}: D(x, d), {rows}\n![](img/one.png)\n")
    (tmp_path / "docs/speed.md").write_text("# One\n\n<!-- part speed -->\n")
    (tmp_path / "box/__init__.py").write_text("")
    (tmp_path / "box/thing.py").write_text(THING)
    (tmp_path / "other/thing.py").write_text("x = 1\n")
    (tmp_path / "assets/weights/a.safetensors").write_bytes(b"weights")
    part = pages.Part("speed", tmp_path)
    part.save(Figure(), "one.png")
    part.write({"text": "half", "rows": [("a", 1, 0.5), ("b", 2, float("nan"))]}, "0123456")
    return part


def test_a_part_ends_with_its_command_and_the_commit_that_made_it(pages, part, capsys):
    text = part.path.read_text()
    assert text.startswith("# One\n\n<!-- part speed -->\n\nhalf: D(x, d), | a | 1 | 0.50 |\n| b | 2 | – |\n")
    stamp = pages.STAMP.fullmatch(text.splitlines(keepends=True)[-1])
    assert stamp["command"] == "python docs/pages.py speed"
    assert len(stamp["commit"]) >= 7
    assert (pages.check([part]), capsys.readouterr().out) == ([], "")
    with pytest.raises(ValueError, match=r"speed\.md: rows, tail: key or value alone"):
        part.write({"text": "", "tail": ""}, "0123456")
    part.path.write_text("<!-- part speed -->\n")
    assert pages.check([part]) == [EDITED]
    with pytest.raises(ValueError, match=r"speed\.md: part speed has no stamp"):
        part.restamp()
    part.path.write_text("# One\n")
    with pytest.raises(ValueError, match=r"speed\.md: no line <!-- part speed -->"):
        part.split()


@pytest.mark.parametrize("file", ["docs/speed.md", "docs/img/one.png"])
def test_a_part_or_picture_that_was_edited_is_refused_until_it_is_stamped(pages, part, file, capsys):
    path = part.root / file
    path.write_bytes(path.read_bytes().replace(b"half", b"hole") + b" ")
    if file.endswith(".md"):
        path.write_text(path.read_text().removesuffix(" "))
    assert pages.check([part]) == [EDITED]
    part.restamp()
    assert pages.check([part]) == []
    assert "the code has changed" not in part.path.read_text()


@pytest.mark.parametrize(
    ("file", "content", "older"),
    [
        ("assets/weights/a.safetensors", "others", True),
        ("assets/weights/b.safetensors", "more", True),
        ("docs/parts/speed.md", "# Two\n", True),
        ("box/thing.py", THING.replace("2 * x", "3 * x"), True),
        ("box/thing.py", "# new\ndef double(\n    x,\n):\n    '''Two times.'''\n    return (2 * x)\n", False),
        ("other/thing.py", "x = 2\n", False),
    ],
)
def test_a_part_whose_code_or_assets_changed_is_listed_and_no_failure(
    pages, part, file, content, older, capsys
):
    (part.root / file).write_text(content)
    assert pages.check([part]) == []
    assert ("speed.md, part speed: made at" in capsys.readouterr().out) == older
    before = part.split()[2]
    part.restamp()
    part.restamp()
    after = part.split()[2]
    assert (after["commit"], after["code"]) == (before["commit"], before["code"])
    note = f"*This part was made at commit {before['commit']}. The code has changed since then.*"
    assert part.path.read_text().count(note) == older


def test_a_part_is_replaced_and_the_rest_of_its_page_stays(pages, tmp_path):
    (tmp_path / "docs/parts").mkdir(parents=True)
    (tmp_path / "docs/layers.py").write_text("x = 1\n")
    (tmp_path / "docs/parts/loihi.md").write_text("{rows}\n")
    old, part = pages._stamp("x", "0", "0", "0"), pages.Part("loihi", tmp_path)
    after = f"between\n<!-- part deploy -->\nothers\n{old}"
    part.path.write_text(f"before\n<!-- part loihi -->\nold\n{old}{after}")
    part.write({"rows": pd.DataFrame({"new": [1.0], "rows": ["two"]})}, "0123456")
    table = "| new | rows |\n|---|---|\n| 1.00 | two |"
    assert part.split()[:2] == ("before\n<!-- part loihi -->\n", f"\n{table}\n\n")
    assert part.path.read_text().endswith(after)
    part.path.write_text(part.path.read_text().replace("before", "changed").replace("others", "more"))
    assert pages.check([part]) == []
    part.path.write_text(f"<!-- part loihi -->\n{after}")  # the stamp is that of the next part
    assert part.split()[2] is None


def test_every_part_has_a_function_and_none_was_edited(pages):
    assert pages.check([pages.Part(name) for name in pages.PARTS]) == []
    for _, script in pages.PARTS.values():
        file, function = script.split(".")
        assert f"def {function}(part: Part, given: Namespace) -> Values:" in (DOCS / f"{file}.py").read_text()
    assert {path.stem for path in (DOCS / "parts").glob("*.md")} == pages.PARTS.keys()
