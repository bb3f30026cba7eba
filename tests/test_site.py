"""Pages of the site that come from the code."""

import importlib.util
import json
from pathlib import Path

import pytest

pytest.importorskip("mkdocs")
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site():
    spec = importlib.util.spec_from_file_location("site_hook", ROOT / "docs" / "site.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_first_page_shows_five_rows_of_the_readmes_table(site):
    head, _, *rows = site.readme_rows().splitlines()
    readme = (ROOT / "README.md").read_text("utf-8").splitlines()
    assert len(rows) == site.ROWS == 5
    assert {head, *rows} <= set(readme)
    assert any("Att-SNN on the emulated chip" in row for row in rows)
    assert "<!-- results -->" in (ROOT / "docs" / "index.md").read_text("utf-8")


def test_the_first_page_shows_a_small_video(site):
    assert 'src="img/flight.mp4"' in (ROOT / "docs" / "index.md").read_text("utf-8")
    assert (ROOT / "docs" / "img" / "flight.mp4").stat().st_size < 1_500_000


def test_keys_of_files_have_ranges_units_and_defaults(site):
    lines = site.toml_files().splitlines()
    assert "| `mass` | Mass [kg]. | float 0.001 to 1000.0 kg | *required* |" in lines
    assert "| `motor` | Constants shared by all rotors. | Motor | *required* |" in lines


def test_types_of_keys_are_shown_without_validators(site):
    text = site.toml_files()
    assert "| 3 × float 0.0 to 10.0 m² | *required* |" in text
    assert "| 2 × float 0.05 to 3600.0 s |" in text
    assert "| float 0.001 to 100000.0 or none | `None` |" in text
    assert not any(word in text for word in ("Annotated", "<function", "Validator", "MinLen"))


def test_every_verb_has_its_section(site):
    text = site.verb_reference()
    assert all(f"## `quadsim {verb}`\n" in text for verb in ("generate", "bench", "report", "identify"))


@pytest.mark.parametrize("name", ["data", "estimator", "scenario", "train"])
def test_a_tutorial_is_also_a_notebook_with_every_block_that_tests_run(site, name):
    tutorial = (ROOT / "docs" / "tutorials" / f"{name}.md").read_text("utf-8")
    cells = json.loads(site.notebook(tutorial))["cells"]
    install, *code = ["".join(each["source"]) for each in cells if each["cell_type"] == "code"]
    assert "%pip install" in install
    blocks = [(file, text) for skipped, _, file, text in site.BLOCK.findall(tutorial) if not skipped]
    assert len(code) == len(blocks) > 2
    for cell, (file, text) in zip(code, blocks, strict=True):
        assert cell.endswith(text.strip())
        assert cell.startswith(f"%%writefile {file}\n") == bool(file)
