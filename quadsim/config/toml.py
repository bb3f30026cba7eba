"""Configuration: TOML files, shipped or the user's, are parsed into frozen, typed models.

A TOML file is complete: it inherits nothing, and an unknown key is an error. Pydantic's `model_dump_json` and
`model_validate_json` convert models to JSON and back without loss.
"""

import difflib
import json
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, RootModel, ValidationError
from pydantic_core import ErrorDetails

from ..runs.fingerprint import ASSETS, ROOT

LARGEST = 1_000_000
"""Largest TOML file that makes sense [bytes]."""


class Strict(BaseModel):
    """Parent of every configuration model: frozen, with finite numbers; unknown keys are errors."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True, validate_default=True
    )


Model = TypeVar("Model", bound=BaseModel)


def preset_names(folder: str) -> list[str]:
    """Return the names of the presets that ship in a folder ("vehicles", "imus", "scenarios"), sorted."""
    return sorted(item.stem for item in shipped_folder(folder).glob("*.toml"))


def load_toml(source: str | Path, folder: str, model: type[Model]) -> Model:
    """Load a preset or a user's TOML file into a model.

    Args:
        source: Name of a preset, or a path: anything that ends in `.toml` or contains a directory. Relative
            paths inside a recipe or a scenario start from the folder of that file.
        folder: Kind of preset: "vehicles", "imus" or "scenarios".
        model: Model to build.

    Raises:
        ValueError: One line with the file, the key, its value and what is allowed.
    """
    file = _find(source, folder)
    label = f"{folder}/{source}" if _is_preset(source) else str(source)
    of_flights = folder in ("recipes", "scenarios") and not _is_preset(source)
    return parse(read_toml(read_text(file, label), label), model, label, file.parent if of_flights else None)


def read_toml(text: str, label: str) -> dict[str, Any]:
    """Parse TOML text into tables.

    Args:
        text: The text.
        label: Name of the text in error messages.

    Raises:
        ValueError: The text is not valid TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of a whole number of thousands of digits
        raise ValueError(f"{label}: not valid TOML: {str(error).split(';')[0]}") from error


def _located(value: Any, folder: Path, key: str = "") -> Any:
    """Return the tables of a file, with relative paths starting from the file's folder.

    The keys `vehicle`, `imu` and `external` hold a path unless they hold the name of a preset. The key
    `function` always holds a path.
    """
    if isinstance(value, dict):
        return {name: _located(inner, folder, name) for name, inner in value.items()}
    if isinstance(value, list):
        return [_located(inner, folder) for inner in value]
    if isinstance(value, str) and (
        (key == "function" and ".py:" in value)
        or (key in ("vehicle", "imu", "external") and not _is_preset(value))
    ):
        return str(folder / Path(value).expanduser())
    return value


def _is_preset(source: str | Path) -> bool:
    """Return whether a source is the name of a preset and not a path."""
    path = Path(source)
    return not (isinstance(source, Path) or path.suffix == ".toml" or len(path.parts) > 1)


def read_text(path: Path, label: str) -> str:
    """Read a user's file as UTF-8 text.

    Args:
        path: The file.
        label: Name of the file in error messages.

    Raises:
        ValueError: The path is not a plain file, or the file is too large, not text or not readable.
    """
    try:
        if path.exists() and not path.is_file():
            raise ValueError(f"{label}: not a plain file")
        if (size := path.stat().st_size) > LARGEST:
            raise ValueError(
                f"{label}: the file has {size / 1e6:.0f} MB; at most {LARGEST / 1e6:g} MB are allowed"
            )
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{label}: not a text file in UTF-8 ({error.reason} at byte {error.start})"
        ) from error
    except OSError as error:
        raise ValueError(f"{label}: cannot be read: {error.strerror}") from error


def parse(data: dict[str, object], model: type[Model], label: str, folder: Path | None = None) -> Model:
    """Build a model from the tables of a TOML file.

    Values of the wrong type, such as quoted numbers, are errors.

    Args:
        data: Content of the file.
        model: Model to build.
        label: Name of the data in error messages, usually the file name.
        folder: Folder from which relative paths start; None leaves paths unchanged.

    Raises:
        ValueError: One line with the label, the key, its value and what is allowed.
    """
    try:
        data = data if folder is None else _located(data, folder)
        return model.model_validate_json(json.dumps(data, default=str), strict=True)
    except ValidationError as error:
        raise ValueError(": ".join(filter(None, (label, describe(error, model))))) from error


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with some of them changed; in a table, only the changed keys are replaced.

    Args:
        base: The original values; tables are models or mappings.
        changes: The new values.
    """
    out = dict(base)
    for name, value in changes.items():
        table = out.get(name)
        table = table.model_dump() if isinstance(table, BaseModel) else table
        if isinstance(table, Mapping) and isinstance(value, Mapping):
            value = merged(table, value)
        out[name] = value
    return out


def describe(error: ValidationError, model: type[BaseModel]) -> str:
    """Describe the first error in a model's input in one line, with the number of further errors.

    Unknown keys come first, because a mistyped key also causes a missing key.
    """
    first, *others = sorted(
        error.errors(include_url=False), key=lambda each: each["type"] != "extra_forbidden"
    )
    return _describe_one(first, model) + (f" (and {len(others)} more)" if others else "")


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return a hint for a mistyped name: the nearest valid name, if one is similar, and all valid names."""
    names = list(valid)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return (f'did you mean "{close[0]}"? ' if close else "") + f"valid: {', '.join(names) or 'none'}"


def shipped_folder(folder: str) -> Path:
    """Return the folder of the presets of a kind; it never depends on the working directory."""
    return (ROOT if folder.startswith("scenarios") else ASSETS) / folder


def _find(source: str | Path, folder: str) -> Path:
    """Return the file that a preset name or a path refers to."""
    path = Path(source).expanduser()
    if not _is_preset(source):
        if path.is_file():
            return path
        reason = "is a directory, not a TOML file" if path.is_dir() else "no such file"
        raise ValueError(f"{source}: {reason}; presets: {', '.join(preset_names(folder)) or 'none'}")
    if source in preset_names(folder):
        return shipped_folder(folder) / f"{source}.toml"
    kind = Path(folder).name.removesuffix("s")
    raise ValueError(
        f'unknown {kind} "{source}"; {nearest(str(source), preset_names(folder))}, or a path to a .toml'
    )


def _describe_one(error: ErrorDetails, model: type[BaseModel]) -> str:
    path, models = _follow(error["loc"], model)
    key = str(error["loc"][-1]) if error["loc"] else ""
    match error["type"]:
        case "extra_forbidden":
            valid = [name for owner in models for name in owner.model_fields]
            inside = [name for owner in models for name in _dotted(owner) if name.endswith(f".{key}")]
            hint = f'did you mean "{inside[0]}"?' if inside else nearest(key, valid)
            return f'unknown key "{_shorten(path)[1:-1]}"; {hint}'
        case "missing":
            return f'missing key "{path}"'
        case "union_tag_not_found":
            tag = str(error.get("ctx", {}).get("discriminator", "")).strip("'")
            return f'missing key "{path}.{tag}"'
        case "union_tag_invalid":
            context = error.get("ctx", {})
            tag, known = (str(context[key]).replace("'", "") for key in ("discriminator", "expected_tags"))
            return f'{path}.{tag} = "{context["tag"]}"; {nearest(context["tag"], known.split(", "))}'
    message = " ".join(error["msg"].removeprefix("Value error, ").removeprefix("Input ").split())
    if path and isinstance(error["input"], dict):  # the message names the key of the table
        return f"{path}: {message}"
    return f"{path} = {_shorten(error['input'])}: {message}" if path else message


def _follow(location: tuple[int | str, ...], model: type[BaseModel]) -> tuple[str, list[type[BaseModel]]]:
    """Return the path of a key as the user would write it, and the models that could have its last key."""
    path, inside = "", [model]
    if issubclass(model, RootModel):
        inside = _models_in_field(model, "root")
    owners = inside
    for step in location:
        if isinstance(step, int):
            path += f"[{step}]"
            continue
        tagged = [candidate for candidate in inside if step in _tags(candidate)]
        if tagged and not any(step in candidate.model_fields for candidate in inside):
            inside = tagged  # the tag of a union, which is not a key of the file
            continue
        path += f".{step}" if path else step
        owners = inside
        if any(step in owner.model_fields for owner in owners):  # else a name that the user chose
            inside = [found for owner in owners for found in _models_in_field(owner, step)]
    return path, owners


def _dotted(model: type[BaseModel]) -> list[str]:
    """Return the keys of the tables in a model, as "table.key"."""
    tables = ((name, inner) for name in model.model_fields for inner in _models_in_field(model, name))
    return [f"{name}.{key}" for name, inner in tables for key in inner.model_fields]


def _models_in_field(model: type[BaseModel], key: str) -> list[type[BaseModel]]:
    return _models_in(model.model_fields[key].annotation) if key in model.model_fields else []


def _models_in(annotation: object) -> list[type[BaseModel]]:
    """Return the models named anywhere in a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in get_args(annotation) for found in _models_in(part)]


def _tags(model: type[BaseModel]) -> set[object]:
    """Return the literal values of a model's fields, which distinguish the members of a union."""
    annotations = (field.annotation for field in model.model_fields.values())
    return {value for item in annotations if get_origin(item) is Literal for value in get_args(item)}


def _shorten(value: object) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 60 else text[:57] + "..."
