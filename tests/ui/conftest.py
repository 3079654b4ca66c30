"""A real window per test, and nothing of it left afterwards."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fakes import small_sensor
from PySide6.QtCore import QEvent
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot
from vtkmodules.vtkRenderingCore import vtkRenderWindow
from window_driver import Driver

from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.sensor import Sensor
from bubbleviz.simulation.synthetic_source import default_press
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver_server import Server
from bubbleviz_ui.engine.solver_thread import Worker
from bubbleviz_ui.engine.source_openers import CachedSource
from bubbleviz_ui.main_window import MainWindow
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.view3d.render_quality import FAST, RenderQuality
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.window_session import application

SIZE = 1024, 700
"""Smallest that the window is made for, px; pictures of larger ones take their time here."""


@pytest.fixture(scope="session")
def sensor() -> Sensor:
    return small_sensor()


@pytest.fixture(scope="session")
def press(sensor: Sensor) -> FrameSource:
    """The window's own synthetic press on a small sensor."""
    return CachedSource(default_press(sensor))


@pytest.fixture(scope="session")
def qapp() -> QApplication:
    """The window's own application, in tests without a window as well."""
    return application()


@pytest.fixture
def drive(qtbot: QtBot, sensor: Sensor, press: FrameSource) -> Iterator[Callable[..., Driver]]:
    """Open windows: `drive(open_source=…, frame=…, playing=…, live=…, quality=…)`."""
    application()
    windows: list[MainWindow] = []

    def make(
        open_source: Callable[[Sensor], FrameSource] = lambda _: press,
        sensor: Sensor = sensor,
        frame: int = 0,
        playing: bool = False,
        live: bool = False,
        quality: RenderQuality = FAST,
    ) -> Driver:
        server = Server()
        controller = Controller(SessionState(), Worker(server))
        window = MainWindow(controller.state, controller, quality)
        window.resize(*SIZE)
        windows.append(window)
        controller.opening.open(
            "press", open_source, lambda: sensor, frame=frame, playing=playing, live=live
        )
        window.show()
        driver = Driver(qtbot, window, server)
        driver.wait(lambda: controller.result is not None)
        driver.settle() if not playing else None
        return driver

    yield make
    while windows:
        _close(windows.pop())


@pytest.fixture
def open_bench(qtbot: QtBot, tmp_path: Path) -> Iterator[Callable[[], Any]]:
    """Open windows for live sources, on which nothing is open yet."""
    from live_bench import Bench

    application()
    windows: list[MainWindow] = []

    def make() -> Bench:
        server = Server()
        controller = Controller(SessionState(), Worker(server))
        window = MainWindow(controller.state, controller)
        window.resize(*SIZE)
        windows.append(window)
        window.show()
        return Bench(qtbot, window, server, tmp_path)

    yield make
    while windows:
        _close(windows.pop())


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    """Fail a test that leaves a window, a VTK render window or a solver thread alive."""
    yield
    app = QApplication.instance()
    if app is None:
        return
    app.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    app.processEvents()
    gc.collect()
    left = [object.__repr__(w) for w in QApplication.topLevelWidgets()]
    # not isinstance, which asks proxies, and they may be dead; types, of which there are few
    objects = gc.get_objects()
    kinds = {kind for kind in {*map(type, objects)} if issubclass(kind, (View, vtkRenderWindow))}
    left += [object.__repr__(o) for o in objects if type(o) in kinds] if kinds else []
    del objects
    left += [t.name for t in threading.enumerate() if t.name.startswith(("solver", "calibration"))]
    assert not left, f"left alive: {left}"
    gc.freeze()  # the next test looks at its own objects only, not at every module's


def _close(window: MainWindow) -> None:
    from shiboken6 import isValid

    if isValid(window):
        window.end()
