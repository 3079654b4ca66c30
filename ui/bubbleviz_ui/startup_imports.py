"""Importing what a window is made of: most of the time from a process's start to its picture."""

from __future__ import annotations

import linecache
import sys
from types import ModuleType
from typing import Any

from bubbleviz.lazy_imports import (
    everything_stays,
    hidden,
    import_later,
    import_without,
    made_later,
)


def import_the_backend() -> None:
    """Import what looks at a recording, before there is a window."""
    for part in ("f2py", "testing"):  # SciPy asks for all of NumPy
        import_without("numpy", part)
    with everything_stays():
        import bubbleviz.frames.sensor_matching  # noqa: F401


def import_the_window() -> None:
    """Import it once, without what it never shows."""
    if "bubbleviz_ui.main_window" in sys.modules:
        return
    import_without("matplotlib", "pyplot")
    import_without("scipy", "ndimage")
    import_later("pooch")
    charts = made_later("matplotlib.backends.backend_agg", "FigureCanvasAgg")
    with everything_stays(), charts, hidden("mypy"):
        # First what knows no Qt: PySide6 reads the source of every module that is imported after it
        import pyvista.plotting  # noqa: F401

        import bubbleviz_ui.engine.solver_server

        _import_pyvistaqt()
        import bubbleviz_ui.main_window  # noqa: F401
    linecache.clearcache()  # the sources it read, tens of MB


def _import_pyvistaqt() -> None:
    """Import it without qtpy, which has PySide6 make every class of Qt, used or not."""
    if "qtpy" in sys.modules:
        return
    from PySide6 import QtCore, QtGui, QtOpenGLWidgets, QtWidgets  # with the window

    parts = {part.__name__: part for part in (QtCore, QtGui, QtWidgets, QtOpenGLWidgets)}
    names = ["qtpy", *(name.replace("PySide6", "qtpy") for name in parts)]
    sys.modules.update((name, _AllOfQt(name, parts)) for name in names)
    try:
        import pyvistaqt  # noqa: F401
    except ImportError:
        pass  # another version, which asks for more of qtpy: imported with that where it is used
    finally:
        for name in names:
            del sys.modules[name]


class _AllOfQt(ModuleType):
    """Has every name of some of Qt's modules, and these, as qtpy and its modules have."""

    def __init__(self, name: str, parts: dict[str, ModuleType]) -> None:
        super().__init__(name)
        self.__path__: list[str] = []
        self._parts = parts

    def __getattr__(self, name: str) -> Any:
        if part := self._parts.get(f"PySide6.{name}"):
            return part
        for part in self._parts.values():
            if hasattr(part, name):
                return getattr(part, name)
        raise AttributeError(name)
