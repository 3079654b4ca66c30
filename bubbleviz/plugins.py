"""Recording formats, live sources and solvers that other packages add by entry points."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any, Literal

from bubbleviz.errors import InputError

Group = Literal["readers", "sources", "solvers"]


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
