"""Libraries of optional extras; formats, sources and solvers that other packages add."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Literal

from bubbleviz.errors import InputError
from bubbleviz.wording import how_to_install

Group = Literal["readers", "sources", "solvers"]


def library(name: str, extra: str, what: str = "", instead: str = "") -> Any:
    """A library of an optional extra, for `what`; `instead`: what else to do without it.

    Raises
    ------
    InputError
        It cannot be imported.
    """
    try:
        return import_module(name)
    except ImportError as error:
        prefix, suffix = what and f"{what}: ", instead and f", or {instead}"
        raise InputError(
            f"{prefix}{name} cannot be imported ({error}); run {how_to_install(extra)}{suffix}"
        ) from error


def plugin(group: Group, name: str) -> Any:
    """Object of the entry point `name` in `bubbleviz.<group>`; None if there is none.

    Raises
    ------
    InputError
        It cannot be loaded.
    """
    for point in entry_points(group=f"bubbleviz.{group}", name=name):
        try:
            return point.load()
        except Exception as error:  # imports of other packages may raise anything
            package = point.dist.name if point.dist is not None else point.module
            raise InputError(
                f"{name}: the plug-in of package {package} cannot be loaded ({error}); "
                "update or uninstall that package"
            ) from error
    return None


def plugin_names(group: Group) -> list[str]:
    """Names of the entry points in `bubbleviz.<group>`."""
    return sorted(entry_points(group=f"bubbleviz.{group}").names)
