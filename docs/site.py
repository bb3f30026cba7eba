"""Hook of MkDocs: pages of the site that come from the code, and the results on the landing page.

`mkdocs build` (make docs) calls the functions below. The reference of the command line comes from the verbs,
that of the files from the typed models.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from annotated_types import Ge, Gt, Le, Lt
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from notebooks import NAMES, with_outputs
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from typer.core import TyperGroup

from estimators.tuned import Tuned
from quadsim.cli import app
from quadsim.config.ranges import Between
from quadsim.external import ExternalSpec
from quadsim.flight.recipe import Recipe
from quadsim.flight.scenario import Scenario
from quadsim.held_out import HeldOut
from quadsim.imu.spec import ImuSpec
from quadsim.vehicle import Vehicle
from training.config import Preset

ROOT = Path(__file__).parents[1]
KINDS: dict[str, tuple[type[BaseModel], str]] = {
    "vehicle": (Vehicle, "A multirotor: `assets/vehicles/`, `--vehicle`."),
    "imu": (ImuSpec, "An IMU and its errors: `assets/imus/`, `--imu`."),
    "external": (ExternalSpec, "A sensor of position, velocity and yaw: `assets/externals/`, `--external`."),
    "recipe": (Recipe, "What `quadsim generate` simulates: `assets/recipes/`, `--recipe`."),
    "scenario": (Scenario, "What `quadsim fly` and `quadsim bench` simulate: `scenarios/`."),
    "preset": (
        Preset,
        "How a network is trained: `assets/presets/`, `--preset`; `--set` takes the same keys.",
    ),
    "tuning": (Tuned, "A filter's parameters, a table for each: `assets/tuning/`, `--tuning`."),
    "held-out": (HeldOut, "A held-out suite: `assets/held-out/`."),
}
"""Kinds of TOML files, the model that checks each, and where it is used."""
STAMP = re.compile(r"<!-- made by: [^>]*-->\n?")
ROWS = 4
"""Rows of the result table on the landing page."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, and those from the repository's root."""
    pages = {"reference/cli.md": command_line(), "reference/toml.md": toml_files()}
    for name in ("CHANGELOG", "CONTRIBUTING"):
        pages[f"{name.lower()}.md"] = (ROOT / f"{name}.md").read_text("utf-8").replace("](docs/", "](")
    for uri, text in pages.items():
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put the README's results and the outputs of notebooks in place, and leave stamps out."""
    del config, files
    folder, _, name = page.file.src_uri.removesuffix(".md").rpartition("/")
    if folder == "tutorials" and name in NAMES:
        markdown = with_outputs(name, markdown)
    return STAMP.sub("", markdown.replace("<!-- results -->", results()))


def results() -> str:
    """First rows of the README's table of errors, which docs/readme.py makes."""
    lines = (ROOT / "README.md").read_text("utf-8").splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("| roll and pitch from"))
    rows = [line for line in lines[head + 2 :] if line.startswith("|")]
    wanted = [row for row in rows if "trained for this" not in row and "Att-RNN" not in row]
    return "\n".join([*lines[head : head + 2], *wanted[:ROWS]])


def command_line() -> str:
    """Every verb with its options."""
    group = typer.main.get_command(app)
    parts = ["# Command line", "`quadsim VERB --help` shows the same in a terminal."]
    parts += [part for command in verbs(group, "quadsim") for part in described(*command)]
    return "\n\n".join(parts)


def verbs(group: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Names and commands of a group, and of the groups in it."""
    for key, command in group.commands.items():
        if isinstance(command, TyperGroup):
            yield from verbs(command, f"{name} {key}")
        else:
            yield f"{name} {key}", command


def described(name: str, command: Any) -> Iterator[str]:
    """Heading, text and options of a verb."""
    yield f"## {name}"
    text = re.sub(r"Example: (.*)", r"```sh\n\1\n```", command.help or "")
    yield text
    rows = []
    for option in command.params:
        if option.name == "help":
            continue
        names = ", ".join(f"`{each}`" for each in option.opts)
        default = "" if option.default in (None, False) or callable(option.default) else f"`{option.default}`"
        rows.append(f"| {names} | {_cell(getattr(option, 'help', '') or '')} | {_cell(default)} |")
    if rows:
        yield "\n".join(["| option | meaning | default |", "|---|---|---|", *rows])


def toml_files() -> str:
    """Every key of every kind of file."""
    parts = [
        "# TOML files",
        "Every key with its unit, range and default, from the models that check the files. An unknown key is "
        "an error that names the nearest one.",
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
    yield "\n".join(["| key | what it is | type and range | default |", "|---|---|---|---|", *rows])
    for field in model.model_fields.values():
        for inner in models_in(field.annotation):
            yield from tables(inner, seen)


def _row(key: str, field: FieldInfo) -> str:
    default = "*required*" if field.is_required() else _default(field)
    kind = range_of(Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation)
    about = field.description or next((_first_line(model) for model in models_in(field.annotation)), "")
    text = f"`{field.alias or key}`", _cell(about), _cell(kind), default
    return f"| {' | '.join(text)} |"


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").strip().split("\n\n")[0]


def _default(field: FieldInfo) -> str:
    if field.default is PydanticUndefined:
        return "depends"
    if field.default is None:
        return "none"
    value = field.default
    if isinstance(value, BaseModel):
        return f"{type(value).__name__}'s own"
    shown = repr(value) if not isinstance(value, float) else f"{value:g}"
    return f"`{_cell(shown)}`" if len(shown) < 60 else "see the code"


def range_of(annotation: Any) -> str:
    """A type in words: with its range and unit where it is a number."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        base, limits = range_of(inner[0]), [_limit(each) for each in inner[1:]]
        return " ".join([base, *filter(None, limits)])
    if origin is Literal:
        return ", ".join(f"`{each}`" for each in inner)
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(range_of(each) for each in inner if each is not type(None)))
    if origin is tuple:
        several = inner[-1] is Ellipsis
        parts = list(dict.fromkeys(range_of(each) for each in inner if each is not Ellipsis))
        return f"list of {parts[0]}" if several else f"{len(inner)} × {' and '.join(parts)}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"[{annotation.__name__}](#{annotation.__name__.lower()})"
    names = {float: "number", int: "whole number", str: "text", bool: "true or false", dict: "table"}
    return names.get(origin or annotation, str(getattr(annotation, "__name__", annotation)))


def _limit(constraint: Any) -> str:
    match constraint:
        case Between(low, high, unit):
            return f"{low:g} to {high:g} {unit}".rstrip()
        case Ge(ge):
            return f"from {ge}"
        case Gt(gt):
            return f"above {gt}"
        case Le(le):
            return f"up to {le}"
        case Lt(lt):
            return f"below {lt}"
    return ""


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Models that a type is made of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for each in get_args(annotation):
        yield from models_in(each)


def _cell(text: str) -> str:
    """A text for a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")
