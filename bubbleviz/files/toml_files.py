"""TOML files: found by name, read, and validated."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from bubbleviz.errors import InputError, given_path
from bubbleviz.files.reading import as_input_error, exists

Model = TypeVar("Model", bound=BaseModel)


def named_file(name: str | Path, presets: Path, what: str) -> Path:
    """The file of that name or, if there is none, the preset of its stem.

    Raises InputError: there is neither.
    """
    path = given_path(what, name)
    if exists(path):
        return path
    path = presets / f"{path.stem}.toml"
    if exists(path):
        return path
    known = ", ".join(sorted(p.stem for p in presets.glob("*.toml")))
    raise InputError(f"{name}: no such {what}; give a .toml file or one of: {known}")


def read_toml(path: Path) -> dict[str, Any]:
    """Tables of a TOML file.

    Raises InputError: it cannot be read, or is not TOML.
    """
    with as_input_error(path, "the TOML file", "correct the file or its path"):
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))  # with Windows' mark or without


def checked(
    model: type[Model],
    data: Mapping[str, Any],
    path: Path,  # for the message
    kind: str,  # name of the content in messages about no single key
) -> Model:
    """Validated model of the tables of a file.

    Raises InputError: it violates the schema; names the first invalid key.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{path}: {_first_problem(error, kind)}") from error


def _first_problem(error: ValidationError, kind: str) -> str:
    problem = error.errors()[0]
    key = ".".join(str(part) for part in problem["loc"]) or kind
    if problem["type"] == "extra_forbidden":
        return f"{key}: unknown key; correct its spelling or remove it"
    if problem["type"] == "missing":
        return f"{key}: missing; add it"
    if problem["type"] == "model_type":
        return f"{key}: needs to be one table; begin it with [{key}]"
    message = problem["msg"].removeprefix("Value error, ").replace("Input should", "it should")
    if isinstance(problem["input"], dict):  # an entire section
        return f"{key}: {message}"
    return f"{key} = {problem['input']!r}: {message}{_unit_of(key)}"


def _unit_of(key: str) -> str:
    """Hint at the unit of a key, by its suffix."""
    if key.endswith("_per_m"):
        return "; tensions are in newtons per metre"
    if key.endswith("_pa"):
        return "; pressures are in pascals"
    return "; lengths are in metres" if key.endswith("_m") else ""
