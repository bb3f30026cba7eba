"""Hook of MkDocs: pages of the site that come from the code, the results on its first page, and notebooks.

`mkdocs build` (make docs) calls the functions below. The reference of the command line comes from the verbs,
that of the files from the typed models. Each tutorial can also be had as a notebook.
"""

import re
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, get_args

import jupytext
import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from typer.cli import get_docs_for_click

from estimators.tuned import Tuned
from quadsim.cli import app
from quadsim.external import ExternalSpec
from quadsim.flight.recipe import Recipe
from quadsim.flight.scenario import Scenario
from quadsim.held_out import HeldOut
from quadsim.imu.spec import ImuSpec
from quadsim.vehicle import Vehicle
from scenarios.task.specification import Task
from training.config import CircuitTraining, TrainingRecipe

ROOT = Path(__file__).parents[1]
KINDS: dict[str, tuple[type[BaseModel], str]] = {
    "vehicle": (Vehicle, "A multirotor, given by `--set vehicle=`. Shipped files: `assets/vehicles/`."),
    "imu": (ImuSpec, "An IMU and its errors, given by `--set imu=`. Shipped files: `assets/imus/`."),
    "external": (
        ExternalSpec,
        "A sensor of position, velocity and yaw, given by `--set external=`. Shipped files: "
        "`assets/externals/`.",
    ),
    "recipe": (
        Recipe,
        "Flights that `quadsim generate` simulates, given by `--recipe`. Shipped files: `assets/recipes/`.",
    ),
    "scenario": (
        Scenario,
        "A flight that `quadsim fly` and `quadsim bench` simulate. Shipped files: `scenarios/`.",
    ),
    "preset": (
        CircuitTraining,
        "Settings for the training of a circuit, given by `--preset` and changed by `--set`. Shipped files: "
        "`assets/presets/`.",
    ),
    "preset of a network of layers": (
        TrainingRecipe,
        "Settings for the training of a network of layers, given by `--preset` and changed by `--set`. "
        "Shipped files: `assets/presets/`.",
    ),
    "tuning": (
        Tuned,
        "Parameters of filters, one table per filter, given by `--set tuning=`. Shipped files: "
        "`assets/tuning/`.",
    ),
    "held-out": (HeldOut, "A held-out suite. Shipped files: `assets/held-out/`."),
    "task": (Task, "A benchmark task, given by `quadsim bench --task`. Shipped files: `assets/tasks/`."),
}
"""Kinds of TOML files, the model that checks each, and where it is used."""
BLOCK = re.compile(
    r"(<!-- not run: [^>]+-->\n)?```(sh|python|toml|c)(?: title=\"([^\"]+)\")?\n(.*?)```", re.DOTALL
)
"""A block of code of a tutorial: why it is not run, its language, the file that it belongs in, its text."""
INSTALL = f"""```python
# In a clone: python -m build --wheel. Put the wheel from dist/ beside this notebook.
%pip install --quiet "quadsim-{version("quadsim")}-py3-none-any.whl[train,export,rl]"
```
"""
STAMP = re.compile(r"<!-- made by: [^>]*-->\n?")
RANGE = re.compile(r"Annotated\[(\w+), Between\(low=(\S+), high=(\S+?)(?:, unit='(.*?)')?\)\]")
VALIDATED = re.compile(r"Annotated\[((?:[^\[\],]|\[[^\[\]]*\])+), (?:\w+\((?:<[^>]*>|[^()<])*\)(?:, )?)+\]")
"""A type with validators, which are no part of what a reader has to know."""
REPEATED = re.compile(r"tuple\[([^,\[\]]+)((?:, \1)+)\]")
ROWS = 5
"""Rows of the result table on the landing page."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, and those from the repository's root."""
    pages = {"reference/cli.md": verb_reference(), "reference/toml.md": toml_files()}
    for name in ("CHANGELOG", "CONTRIBUTING"):
        pages[f"{name.lower()}.md"] = (ROOT / f"{name}.md").read_text("utf-8").replace("](docs/", "](")
    for each in files:
        if has_notebook(each):
            pages[each.src_uri.replace(".md", ".ipynb")] = notebook(each.content_string)
    for uri, text in pages.items():
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put the README's results in place, and leave stamps out."""
    del config, files
    if has_notebook(page.file):
        title, _, rest = markdown.partition("\n")
        link = f"{Path(page.file.src_uri).stem}.ipynb"
        markdown = f'{title}\n\n[This page as a notebook]({link}){{ download="{link}" }}\n{rest}'
    return STAMP.sub("", markdown.replace("<!-- results -->", readme_rows()))


def has_notebook(file: File) -> bool:
    """Whether a page is a tutorial with code."""
    return file.src_uri.startswith("tutorials/") and bool(BLOCK.search(file.content_string))


def notebook(tutorial: str) -> str:
    """A tutorial as a notebook in JSON: cells that install, then its blocks of code between its text.

    Commands of a shell and files become cells with a magic. Blocks that tests do not run stay text.
    """

    def cell(block: re.Match[str]) -> str:
        skipped, language, name, code = block.groups()
        if skipped:
            return "\n".join(f"    {line}" for line in code.splitlines())
        magic = f"%%writefile {name}\n" if name else "%%bash\n" if language == "sh" else ""
        return f"```python\n{magic}{code}```"

    title, _, rest = BLOCK.sub(cell, tutorial).partition("\n")
    made = jupytext.reads(f"{title}\n\n{INSTALL}{rest}", "md")
    made.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return jupytext.writes(made, "ipynb")


def readme_rows() -> str:
    """First rows of the README's table of errors, which docs/errors.py makes."""
    lines = (ROOT / "README.md").read_text("utf-8").splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("| attitude estimator"))
    rows = [line for line in lines[head + 2 :] if line.startswith("|")]
    wanted = [row for row in rows if "trained on Hummingbird" not in row and "Att-RNN" not in row]
    return "\n".join([*lines[head : head + 2], *wanted[:ROWS]])


def verb_reference() -> str:
    """Every verb with its options."""
    command = typer.main.get_command(app)
    with typer.Context(command, info_name="quadsim") as context:
        return get_docs_for_click(obj=command, ctx=context, name="quadsim", title="Command line")


def toml_files() -> str:
    """Every key of every kind of file."""
    parts = [
        "# TOML files",
        "This page lists every key with its unit, range and default. It is generated from the models that "
        "check the files. An unknown key causes an error message that names the nearest valid key.",
    ]
    seen: set[type[BaseModel]] = set()
    for kind, (model, about) in KINDS.items():
        parts += [f"## {kind}", about, *tables(model, seen)]
    return "\n\n".join(parts)


def tables(model: type[BaseModel], seen: set[type[BaseModel]]) -> Iterator[str]:
    """The table of a model, then those of the models in it."""
    if model in seen:
        return
    seen.add(model)
    rows = [_row(key, field) for key, field in model.model_fields.items()]
    yield f"### {model.__name__}"
    yield _first_line(model)
    yield "\n".join(["| key | meaning | type and range | default |", "|---|---|---|---|", *rows])
    for field in model.model_fields.values():
        for inner in models_in(field.annotation):
            yield from tables(inner, seen)


def _row(key: str, field: FieldInfo) -> str:
    kind = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
    about = field.description or next((_first_line(model) for model in models_in(field.annotation)), "")
    about = about or "Selects this table." * (key == "kind")
    default = f"`{field.default!r:.60}`" if field.default_factory is None else "depends"
    default = "*required*" if field.is_required() else default
    return f"| `{field.alias or key}` | {_cell(about)} | {_cell(range_of(kind))} | {_cell(default)} |"


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").strip().split("\n\n")[0]


def range_of(annotation: Any) -> str:
    """A type as Python writes it, without its validators; of a number its range and unit."""
    text = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    text = RANGE.sub(r"\1 \2 to \3 \4", re.sub(r"\b(?:\w+\.)+(?=[A-Za-z])", "", text))
    text = re.sub(r" (?=[,\]]|$)", "", VALIDATED.sub(r"\1", text))
    text = re.sub(r"Optional\[([^\[\]]+)\]", r"\1 or none", text)
    return REPEATED.sub(lambda found: f"{found[2].count(',') + 1} × {found[1]}", text)


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Models that a type is made of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for each in get_args(annotation):
        yield from models_in(each)


def _cell(text: str) -> str:
    """A text for a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")
