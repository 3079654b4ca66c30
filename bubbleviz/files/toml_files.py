"""TOML files: found by name, read, and validated; errors name the key and what to do."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from bubbleviz.errors import InputError
from bubbleviz.files.reading import damage, exists

Model = TypeVar("Model", bound=BaseModel)


def named_file(name: str | Path, presets: Path, what: str) -> Path:
    """The file of that name or, where there is none, the preset of its stem.

    Raises InputError: there is neither; lists the presets.
    """
    path = Path(name)
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
    with damage(path, "the TOML file", "correct it"):
        return tomllib.loads(path.read_text(encoding="utf-8"))


def checked(
    model: type[Model],
    data: Mapping[str, Any],
    path: Path,  # for the message
    whole: str,  # what to call the file's content where no key is to blame
) -> Model:
    """What the tables of a file describe.

    Raises InputError: it breaks the schema; names the first key that does and what to do.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{path}: {_first_problem(error, whole)}") from error


def _first_problem(error: ValidationError, whole: str) -> str:
    problem = error.errors()[0]
    where = ".".join(str(part) for part in problem["loc"]) or whole
    if problem["type"] == "extra_forbidden":
        return f"{where}: unknown key; check its spelling"
    if problem["type"] == "missing":
        return f"{where}: missing; add it"
    message = problem["msg"].removeprefix("Value error, ")
    if isinstance(problem["input"], dict):  # the section as a whole
        return f"{where}: {message}"
    return f"{where} = {problem['input']!r}: {message}{_unit_of(where)}"


def _unit_of(key: str) -> str:
    """Hint at the unit of a key, by how its name ends."""
    if key.endswith("_per_m"):
        return "; tensions are in newtons per metre"
    if key.endswith("_pa"):
        return "; pressures are in pascals"
    return "; lengths are in metres" if key.endswith("_m") else ""
