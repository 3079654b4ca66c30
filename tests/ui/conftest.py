"""Fixtures for windows, with a check for leaks."""

import gc
import threading

import pytest
from fakes import small_sensor
from live_bench import Bench
from PySide6.QtCore import QEvent
from PySide6.QtWidgets import QApplication
from shiboken6 import isValid
from vtkmodules.vtkRenderingCore import vtkRenderWindow
from window_driver import Driver

from bubbleviz.simulation import LoopedSource, default_press
from bubbleviz_ui.engine import sensor_client
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.main_window import MainWindow
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.render_view import FAST, View
from bubbleviz_ui.window_session import application

SIZE = 1024, 700
"""Smallest supported size, px; larger windows render slowly here."""


@pytest.fixture(scope="session")
def sensor():
    return small_sensor()


@pytest.fixture(scope="session")
def press(sensor):
    """The window's own synthetic press on a small sensor."""
    simulated = default_press(sensor)
    return LoopedSource(simulated, simulated.camera)


@pytest.fixture(scope="session")
def qapp():
    """The Qt application, also in tests without a window."""
    return application()


@pytest.fixture(autouse=True)
def few_sampled_frames():
    """Few frames are solved ahead for the scales: of the press, two are in contact."""
    # A patch of its own: that of a test, which may hold the window, is undone before `no_leaks`.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sensor_client, "SAMPLED_FRAMES", 4)
        yield


@pytest.fixture(autouse=True)
def soon_idle():
    """The solver is idle soon after a request: no test waits for work to be delayed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sensor_client, "IDLE_S", 0.05)
        yield


@pytest.fixture
def new_window(qtbot, qapp):
    """Create windows without a source; closed after the test."""
    windows: list[MainWindow] = []

    def make(quality=FAST):
        controller = Controller(SessionState())
        window = MainWindow(controller.state, controller, quality)
        window.resize(*SIZE)
        windows.append(window)
        return window

    yield make
    while windows:
        window = windows.pop()
        if isValid(window):
            window.close_without_asking()
    theme.apply(qapp, theme.DARK)


@pytest.fixture
def drive(qtbot, new_window, sensor, press):
    """Open windows: `drive(open_source=…, frame=…, playing=…, live=…, quality=…)`."""

    def make(open_source=lambda _: press, sensor=sensor, quality=FAST, **at):
        driver = Driver(qtbot, new_window(quality))
        playing = at.setdefault("playing", False)
        driver.open("press", open_source, sensor, **at)
        driver.window.show()
        driver.wait(lambda: not driver.state.facts.is_empty)
        if not playing:
            driver.wait_until_shown()
            driver.wait_until_solved_ahead()
        return driver

    return make


@pytest.fixture
def open_bench(qtbot, new_window, tmp_path):
    """Open windows for live sources, without a source."""

    def make():
        bench = Bench(qtbot, new_window(), tmp_path)
        bench.window.show()
        return bench

    return make


@pytest.fixture(autouse=True)
def no_leaks():
    """Fail a test that leaves a window, its controller, a render window or a thread alive."""
    yield
    app = QApplication.instance()
    if app is None:
        return
    app.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    app.processEvents()
    gc.collect()
    left = [object.__repr__(w) for w in QApplication.topLevelWidgets()]
    # types instead of isinstance, which fails for dead proxies
    objects = gc.get_objects()
    watched = Controller, View, vtkRenderWindow
    kinds = {kind for kind in {*map(type, objects)} if issubclass(kind, watched)}
    left += [object.__repr__(o) for o in objects if type(o) in kinds] if kinds else []
    del objects
    left += [t.name for t in threading.enumerate() if t.name.startswith(("solver", "calibration"))]
    assert not left, f"left alive: {left}"
    gc.freeze()  # the next test scans only its own objects
