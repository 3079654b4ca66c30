"""Fast import of the window's packages: most of the time from process start to first picture."""

from __future__ import annotations

import linecache
import sys
from contextlib import suppress
from types import ModuleType

from bubbleviz.lazy_imports import (
    defer_class,
    import_later,
    import_without,
    quick_imports,
    substitute_modules,
    without_garbage_collection,
)

CHARTS = "vtkmodules.vtkRenderingContextOpenGL2"
"""Drawing of VTK's charts, a library of its own."""
UNUSED = {"mypy": None, CHARTS: ModuleType(CHARTS)}
"""What pyvista would import for nothing."""


def import_the_backend() -> None:
    """Import what checks a recording before the window opens."""
    with quick_imports():
        import bubbleviz.recordings.sensor_matching  # noqa: F401


def import_the_window() -> None:
    """Import the window once, without parts of libraries that it never uses."""
    if "bubbleviz_ui.main_window" in sys.modules:
        return
    import_without("matplotlib", "pyplot")
    import_without("scipy", "ndimage")
    import_later("pooch")
    import_later("pyqtgraph")  # 0.2 s; with the first plot
    charts = defer_class("matplotlib.backends.backend_agg", "FigureCanvasAgg")
    with without_garbage_collection(), charts, substitute_modules(UNUSED):
        # before Qt: PySide6 reads the source of every module imported after it
        import pyvista.plotting  # noqa: F401

        # another version may need more of qtpy, and is imported with it later
        with suppress(ImportError), substitute_modules(_qtpy()):
            import pyvistaqt  # noqa: F401
        import bubbleviz_ui.engine.solver
        import bubbleviz_ui.main_window  # noqa: F401
    linecache.clearcache()  # tens of MB of sources read by PySide6


def _qtpy() -> dict[str, ModuleType]:
    """Modules for pyvistaqt in place of qtpy, which makes PySide6 create every class of Qt."""
    from PySide6 import QtCore, QtGui, QtOpenGLWidgets, QtWidgets

    def widget(name: str) -> object:
        return getattr(QtGui if name == "QAction" else QtWidgets, name)  # moved in Qt 6

    package, widgets = ModuleType("qtpy"), ModuleType("qtpy.QtWidgets")
    package.__dict__.update(QtCore=QtCore, QtGui=QtGui, QtWidgets=widgets)
    widgets.__dict__.update(__getattr__=widget)
    parts = {"QtCore": QtCore, "QtGui": QtGui, "QtOpenGLWidgets": QtOpenGLWidgets}
    named = {f"qtpy.{name}": part for name, part in parts.items()}
    return {"qtpy": package, "qtpy.QtWidgets": widgets, **named}
