"""Every block of code in the README and on the site's pages for readers runs as it stands."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(
    r"(<!-- not run: [^>]+-->\n)?```(sh|python|toml|c)(?: title=\"([^\"]+)\")?\n(.*?)```", re.DOTALL
)
NOT_RUN = ("make ", "quadsim evaluate --logs flight.ulg")
"""Commands of the README that CI runs itself, or that need a recording."""


def blocks_of(path):
    """Language, file and text of each block that is to run."""
    found = BLOCK.findall(path.read_text("utf-8"))
    return [(language, name, text) for skip, language, name, text in found if not skip]


def run(block, folder):
    """Run a block in a folder, or write it to the file that it names."""
    language, name, text = block
    if name:
        (folder / name).write_text(text)
        return
    scripts = Path(sys.executable).parent
    env = os.environ | {"PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", text] if language == "python" else ["bash", "-e", "-c", text]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"{text}\n{done.stdout[-1500:]}\n{done.stderr[-1500:]}"


@pytest.mark.slow
@pytest.mark.parametrize("path", [*TUTORIALS, ROOT / "docs" / "quick-start.md"], ids=lambda path: path.stem)
def test_a_tutorial_runs_block_by_block(path, tmp_path):
    for block in blocks_of(path):
        run(block, tmp_path)


@pytest.mark.slow
def test_the_readmes_commands_run(tmp_path):
    """With flights of a few seconds, in a folder beside the examples."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for language, name, text in blocks_of(ROOT / "README.md"):
        kept = "\n".join(line for line in text.splitlines() if not line.startswith(NOT_RUN))
        short = (
            kept.replace("--flights 35 --duration 100", "--flights 2 --duration 5")
            .replace("--seeds 10", "--seeds 1 --duration 3")
            .replace(" --video", " --duration 2")
            .replace("--scenario step ", "--scenario step --seeds 1 --duration 3 ")
        )
        run((language, name, short), tmp_path)


def test_the_readme_is_short_and_so_are_its_sentences():
    text = (ROOT / "README.md").read_text("utf-8")
    assert len(text.splitlines()) < 150
    prose = re.sub(r"```.*?```|<!--.*?-->|^\|.*$|^#.*$", "\n\n", text, flags=re.DOTALL | re.MULTILINE)
    prose = re.sub(r"\]\([^)]*\)", "]", prose)
    for paragraph in re.split(r"\n\s*\n|\n- ", prose):
        for sentence in re.split(r"(?<=[.!?:])\s", " ".join(paragraph.split())):
            assert len(sentence.split()) <= 30, sentence
