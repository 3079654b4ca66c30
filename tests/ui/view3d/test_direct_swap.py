"""Direct buffer swap: the screen, read back, always shows the current picture."""

from itertools import product

import numpy as np
import pytest
from PySide6.QtCore import QPoint, QRect, QSize, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QWidget
from window_driver import as_pixels

from bubbleviz_ui.view3d.render_view import FAST, SMOOTH

DIFFERENT = 30
"""Colour difference, of 255, above that of dithering and rounding."""
NAMES = FAST.name, SMOOTH.name


def with_points(driver):
    """The driver with measured points shown, whose noise differs in every frame."""
    driver.choose(layers=driver.state.settings.layers | {"cloud"})
    return driver


def on_screen(driver):
    """The view's part of the screen, (height, width, 3)."""
    return seen_of(driver.window.view)


def seen_of(widget):
    """A widget's part of the screen, (height, width, 3)."""
    at, size = widget.mapToGlobal(QPoint(0, 0)), widget.size()
    picture = QApplication.primaryScreen().grabWindow(
        0, at.x(), at.y(), size.width(), size.height()
    )
    return as_pixels(picture.toImage())


def share_that_differs(a, b):
    """Share of differing pixels of two pictures; 1 for different sizes."""
    if a.shape != b.shape:
        return 1.0
    return float((np.abs(a.astype(int) - b).max(axis=2) > DIFFERENT).mean())


def assert_shown(driver, before):
    """Wait until the screen has changed and is stable; then it shows what the view draws."""
    seen = [before]

    def rests():
        seen.append(on_screen(driver))  # not the view's pixels: reading them could trigger a redraw
        return np.array_equal(seen[-1], seen[-2]) and share_that_differs(seen[-1], before) > 1e-3

    driver.wait(rests)
    assert share_that_differs(seen[-1], driver.pixels()) < 1e-3


@pytest.mark.parametrize("quality", [FAST, pytest.param(SMOOTH, marks=pytest.mark.long)], ids=NAMES)
def test_every_frame_reaches_the_screen_and_closed_popups_leave_no_trace(drive, quality):
    """With direct swap, and through Qt."""
    driver = with_points(drive(quality=quality))
    assert (driver.window.view.windowHandle() is not None) is quality.own_swap
    for frame in (10, 0, 14):
        before = on_screen(driver)
        driver.state.seek(frame)
        driver.wait(lambda frame=frame: driver.result.frame.index == frame)
        assert_shown(driver, before)
    # popups over the panels leave no trace
    driver.seek(3)
    kinds = (Qt.WindowType.Popup, Qt.WindowType.ToolTip, Qt.WindowType.Dialog)
    for kind, panel in product(kinds, (driver.window.playback, driver.window.layers)):
        before = seen_of(panel)
        above = QLabel("menu")
        above.setStyleSheet("background: #a03030")
        above.setWindowFlags(kind)
        above.setGeometry(QRect(panel.mapToGlobal(QPoint(20, 10)), QSize(200, 90)))
        above.show()
        driver.wait(lambda panel=panel, before=before: not same(seen_of(panel), before))
        above.close()
        driver.wait(lambda panel=panel, before=before: same(seen_of(panel), before))


@pytest.mark.parametrize("quality", [FAST, pytest.param(SMOOTH, marks=pytest.mark.long)], ids=NAMES)
def test_picture_stays_current_when_the_window_changes(drive, quality):
    driver = with_points(drive(quality=quality))
    window = driver.window

    def before():
        driver.seek(3)
        return on_screen(driver)

    old = before()
    above = QWidget()
    above.setGeometry(window.geometry())
    above.show()
    driver.bot.waitExposed(above)
    driver.seek(12)
    above.close()
    assert_shown(driver, old)

    old = before()
    window.hide()
    driver.state.seek(12)
    driver.wait(lambda: window.controller.result.frame.index == 12)
    window.show()
    driver.bot.waitExposed(window)
    assert_shown(driver, old)

    old = before()
    window.panels["layers"].hide()
    window.panels["kappa"].hide()
    driver.seek(12)
    assert_shown(driver, old)

    old = before()
    window.resize(window.width() - 130, window.height() - 70)
    driver.seek(12)
    assert_shown(driver, old)

    old = before()
    driver.state.change(theme="light")
    assert_shown(driver, old)


def same(a, b):
    return share_that_differs(a, b) < 1e-3


@pytest.mark.long  # in short: below
def test_native_view_and_qt_panels_stay_consistent(drive):
    driver = with_points(drive())
    swapped: list[int] = []
    driver.window.view.frameSwapped.connect(lambda: swapped.append(1))
    driver.window.status.repaint()
    QApplication.processEvents()
    assert not swapped  # Qt has not composed the window again
    # no older picture reappears when Qt paints the window, although its copy is older
    window, swapped = driver.window, list[int]()
    driver.seek(3)
    old = driver.pixels()  # by Qt
    driver.seek(12)
    now = on_screen(driver)
    assert share_that_differs(now, old) > 1e-3
    window.view.frameSwapped.connect(lambda: swapped.append(1))
    window.update()  # as after closing a popup
    driver.wait(lambda: bool(swapped))
    driver.wait(lambda: same(on_screen(driver), now))
    # the mouse reaches the view through its own window
    view, seen = driver.window.view, list[tuple[str, float, float]]()
    view.clicked.connect(lambda x, y: seen.append(("clicked", x, y)))
    view.mouse_moved.connect(lambda x, y: seen.append(("moved", x, y)))
    native = view.windowHandle()
    assert native is not None and native is not driver.window.windowHandle()
    QTest.mouseMove(native, QPoint(40, 50))
    driver.wait(lambda: ("moved", 40.0, 50.0) in seen)
    QTest.mouseClick(native, Qt.MouseButton.LeftButton, pos=QPoint(60, 70))
    driver.wait(lambda: ("clicked", 60.0, 70.0) in seen)
