"""Fast import of the window's packages: most of the time from process start to first picture."""

from __future__ import annotations

import linecache
import sys

from bubbleviz.lazy_imports import (
    defer_class,
    hide_package,
    import_later,
    import_without,
    quick_imports,
    without_garbage_collection,
)


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
    charts = defer_class("matplotlib.backends.backend_agg", "FigureCanvasAgg")
    with without_garbage_collection(), charts, hide_package("mypy"):
        # before Qt: PySide6 reads the source of every module imported after it
        import pyvista.plotting  # noqa: F401

        import bubbleviz_ui.engine.solver
        import bubbleviz_ui.main_window  # noqa: F401
    linecache.clearcache()  # tens of MB of sources read by PySide6
