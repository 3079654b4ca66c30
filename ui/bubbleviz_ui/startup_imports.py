"""Importing what a window is made of: most of the time from a process's start to its picture."""

from __future__ import annotations

import linecache
import sys

from bubbleviz.lazy_imports import (
    defer_class,
    hide_package,
    import_later,
    import_without,
    without_garbage_collection,
)


def import_the_backend() -> None:
    """Import what looks at a recording, before there is a window."""
    for part in ("f2py", "testing"):  # SciPy asks for all of NumPy
        import_without("numpy", part)
    with without_garbage_collection():
        import bubbleviz.recordings.sensor_matching  # noqa: F401


def import_the_window() -> None:
    """Import it once, without what it never shows."""
    if "bubbleviz_ui.main_window" in sys.modules:
        return
    import_without("matplotlib", "pyplot")
    import_without("scipy", "ndimage")
    import_later("pooch")
    charts = defer_class("matplotlib.backends.backend_agg", "FigureCanvasAgg")
    with without_garbage_collection(), charts, hide_package("mypy"):
        # First what knows no Qt: PySide6 reads the source of every module that is imported after it
        import pyvista.plotting  # noqa: F401

        import bubbleviz_ui.engine.solver
        import bubbleviz_ui.main_window  # noqa: F401
    linecache.clearcache()  # the sources it read, tens of MB
