"""Pages of the site that come from the code."""

import importlib.util
import sys
from pathlib import Path

import pytest

pytest.importorskip("mkdocs")
pytest.importorskip("nbclient")
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site():
    """The hook, loaded as MkDocs does: with its folder on the path."""
    sys.path.insert(0, str(ROOT / "docs"))
    spec = importlib.util.spec_from_file_location("site_hook", ROOT / "docs" / "site.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.path.remove(str(ROOT / "docs"))
    yield module
    sys.modules.pop("notebooks", None)


def test_the_first_page_shows_four_rows_of_the_readmes_table(site):
    head, _, *rows = site.results().splitlines()
    readme = (ROOT / "README.md").read_text("utf-8").splitlines()
    assert len(rows) == site.ROWS == 4
    assert {head, *rows} <= set(readme)
    assert any("Att-SNN on the emulated chip" in row for row in rows)
    assert "<!-- results -->" in (ROOT / "docs" / "index.md").read_text("utf-8")


def test_the_first_page_shows_a_small_video(site):
    assert 'src="img/flight.mp4"' in (ROOT / "docs" / "index.md").read_text("utf-8")
    assert (ROOT / "docs" / "img" / "flight.mp4").stat().st_size < 1_500_000


def test_keys_of_files_have_ranges_units_and_defaults(site):
    lines = site.toml_files().splitlines()
    assert "| `mass` | Mass [kg]. | number 0.001 to 1000 kg | *required* |" in lines
    assert "| `motor` | Constants shared by all rotors. | [Motor](#motor) | *required* |" in lines


def test_every_verb_has_its_section(site):
    text = site.command_line()
    assert all(
        f"\n## quadsim {verb}\n" in text for verb in ("generate", "bench", "dataset info", "logs calibrate")
    )
