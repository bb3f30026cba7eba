"""Every block of code in the README and on the site's pages for readers runs as it stands."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from quadsim.cli import main
from quadsim.config.toml import preset_names

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(
    r"(<!-- not run: [^>]+-->\n)?```(sh|python|toml|c)(?: title=\"([^\"]+)\")?\n(.*?)```", re.DOTALL
)
ALONE = re.compile(r"^import gymnasium|__main__", re.MULTILINE)
"""Python that a process of its own shows to be whole: it registers the environment, or starts processes."""
NOT_RUN = ("make ", "quadsim evaluate --logs flight.ulg")
"""Commands of the README that CI runs itself, or that need a recording."""
SHORTER = {
    "--duration 40 --seed 11": "--duration 15 --seed 11",
    "--duration 60 --seed 12": "--duration 15 --seed 12",
    "--particles 6 --iterations 4": "--particles 2 --iterations 2",
}
"""Less work for the same command."""


def blocks_of(path):
    """Language, file and text of each block that is to run."""
    found = BLOCK.findall(path.read_text("utf-8"))
    return [(language, name, text) for skip, language, name, text in found if not skip]


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs a block in a folder, or writes it to the file that it names.

    Commands of ours and Python run in this process, which has imported everything already; a block that
    registers the environment or starts processes has one of its own.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    before = set(sys.modules)

    def run(block):
        language, name, text = block
        if name:
            (tmp_path / name).write_text(text)
        elif language == "sh" and all(line.startswith("quadsim ") for line in commands_of(text)):
            for line in commands_of(text):
                monkeypatch.setattr(sys, "argv", shlex.split(line))
                with pytest.raises(SystemExit) as stop:
                    main()
                assert stop.value.code == 0, f"{line}\n{capsys.readouterr()}"
        elif language == "sh":
            run_alone(["bash", "-e", "-c", text])
        elif ALONE.search(text):
            run_alone([sys.executable, "-c", text])
        else:
            exec(compile(text, text, "exec"), {"__name__": "__main__"})

    yield run
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def commands_of(text):
    return [line for line in text.replace("\\\n", " ").splitlines() if line]


def run_alone(command):
    scripts = Path(sys.executable).parent
    env = os.environ | {"PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout[-1500:]}\n{done.stderr[-1500:]}"


def test_the_table_of_recipes_has_those_that_ship():
    text = (ROOT / "docs" / "tutorials" / "data.md").read_text("utf-8")
    table = text.split("| recipe | use |\n")[1].split("\n\n")[0]
    assert sorted(re.findall(r"`(\S+?)`(?=,| \|)", table)) == preset_names("recipes")


@pytest.mark.slow
@pytest.mark.parametrize("path", [*TUTORIALS, ROOT / "docs" / "quick-start.md"], ids=lambda path: path.stem)
def test_a_tutorial_runs_block_by_block(path, run):
    for language, name, text in blocks_of(path):
        for long, short in SHORTER.items():
            text = text.replace(long, short)
        run((language, name, text))


@pytest.mark.slow
def test_the_readmes_commands_run(run, tmp_path):
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
        run((language, name, short))


def test_the_readme_is_short_and_so_are_its_sentences():
    text = (ROOT / "README.md").read_text("utf-8")
    assert len(text.splitlines()) <= 120
    prose = re.sub(r"(?s:```.*?```)|<!--.*-->|^\|.*$|^#.*$", "\n\n", text, flags=re.MULTILINE)
    prose = re.sub(r"\]\([^)]*\)", "]", prose)
    sentences = [
        sentence
        for paragraph in re.split(r"\n\s*\n|\n- ", prose)
        for sentence in re.split(r"(?<=[.!?:;])\**\s", " ".join(paragraph.split()))
    ]
    assert len(sentences) > 50
    assert [each for each in sentences if len(each.split()) > 30] == []
