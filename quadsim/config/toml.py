"""Configuration: a TOML file, of ours or of the user, becomes a frozen and typed model, or one clear error.

A TOML file stands alone: it inherits nothing, and a key that the model does not know is an error. Models go
to JSON and back without loss with pydantic's own `model_dump_json` and `model_validate_json`.
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
    """Parent of every configuration model: frozen, finite numbers only, no unknown keys."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True, validate_default=True
    )


Model = TypeVar("Model", bound=BaseModel)


def preset_names(folder: str) -> list[str]:
    """Names of the presets that ship in a folder ("vehicles", "imus", "scenarios"), sorted."""
    return sorted(item.stem for item in shipped_folder(folder).glob("*.toml"))


def load_toml(source: str | Path, folder: str, model: type[Model]) -> Model:
    """Load a preset or a user's TOML file into a model; paths in one of a flight count from its folder.

    Args:
        source: Name of a preset, or a path: anything that ends in `.toml` or contains a directory.
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
    """Tables of a TOML text.

    Args:
        text: The text.
        label: What to call it in an error.

    Raises:
        ValueError: One line: it is not valid TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of a whole number of thousands of digits
        raise ValueError(f"{label}: not valid TOML: {str(error).split(';')[0]}") from error


def _located(value: Any, folder: Path, key: str = "") -> Any:
    """A file's tables with the relative paths in them taken from its folder.

    Paths are texts in the keys `vehicle`, `imu` and `external`, unless they are names of presets, and in the
    key `function`.
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
    """Whether a source is a name, not a path: no Path, no suffix of TOML and no folder."""
    path = Path(source)
    return not (isinstance(source, Path) or path.suffix == ".toml" or len(path.parts) > 1)


def read_text(path: Path, label: str) -> str:
    """Text of a user's file in UTF-8.

    Args:
        path: The file.
        label: What to call it in an error.

    Raises:
        ValueError: One line: it is not a plain file, too large, not text, or cannot be read.
    """
    try:
        if path.exists() and not path.is_file():
            raise ValueError(f"{label}: is not a plain file")
        if (size := path.stat().st_size) > LARGEST:
            raise ValueError(f"{label}: {size / 1e6:.0f} MB; at most {LARGEST / 1e6:g} MB are read")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{label}: not a text file in UTF-8 ({error.reason} at byte {error.start})"
        ) from error
    except OSError as error:
        raise ValueError(f"{label}: cannot be read: {error.strerror}") from error


def parse(data: dict[str, object], model: type[Model], label: str, folder: Path | None = None) -> Model:
    """Build a model from the tables of a TOML file; numbers in quotes and the like are not converted.

    Args:
        data: Content of the file.
        model: Model to build.
        label: What to call the data in an error, usually the file's name.
        folder: Where relative paths in them begin; None leaves them as they are.

    Raises:
        ValueError: One line with the label, the key, its value and what is allowed.
    """
    try:
        data = data if folder is None else _located(data, folder)
        return model.model_validate_json(json.dumps(data, default=str), strict=True)
    except ValidationError as error:
        raise ValueError(f"{label}: {describe(error, model)}") from error


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Values with some of them changed; of a table, only the keys that a change names.

    Args:
        base: Values, of which tables are models or mappings.
        changes: What differs from them.
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
    """One line for the first thing wrong in a model's input, with the number of further ones.

    Unknown keys come first: a mistyped key is the reason why another one is missing.
    """
    first, *others = sorted(
        error.errors(include_url=False), key=lambda each: each["type"] != "extra_forbidden"
    )
    return _describe_one(first, model) + (f" (and {len(others)} more)" if others else "")


def nearest(name: str, valid: Iterable[str]) -> str:
    """Hint for a mistyped name: the nearest valid one if one is near, and the list of them all."""
    names = list(valid)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return (f'did you mean "{close[0]}"? ' if close else "") + f"valid: {', '.join(names) or 'none'}"


def shipped_folder(folder: str) -> Path:
    """Where the presets of a kind are: beside this package, whatever the working directory holds."""
    return (ROOT if folder.startswith("scenarios") else ASSETS) / folder


def _find(source: str | Path, folder: str) -> Path:
    """File of a preset name or of a path."""
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
    return f"{path} = {_shorten(error['input'])}: {message}" if path else message


def _follow(location: tuple[int | str, ...], model: type[BaseModel]) -> tuple[str, list[type[BaseModel]]]:
    """Key path as the user would write it, and the models that could hold its last key."""
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
    """Keys of the tables in a model, as "table.key"."""
    tables = ((name, inner) for name in model.model_fields for inner in _models_in_field(model, name))
    return [f"{name}.{key}" for name, inner in tables for key in inner.model_fields]


def _models_in_field(model: type[BaseModel], key: str) -> list[type[BaseModel]]:
    return _models_in(model.model_fields[key].annotation) if key in model.model_fields else []


def _models_in(annotation: object) -> list[type[BaseModel]]:
    """Models named anywhere in a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in get_args(annotation) for found in _models_in(part)]


def _tags(model: type[BaseModel]) -> set[object]:
    """Literal values of a model's fields, by which a union tells its members apart."""
    annotations = (field.annotation for field in model.model_fields.values())
    return {value for item in annotations if get_origin(item) is Literal for value in get_args(item)}


def _shorten(value: object) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 60 else text[:57] + "..."
