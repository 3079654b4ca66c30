"""What is on the screen, read from the screen, is what the view shows at any time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from PySide6.QtGui import QImage
from PySide6.QtWidgets import QApplication, QWidget
from window_driver import Driver

OPEN = Callable[..., Driver]
DIFFERENT = 30
"""Steps of 255: what dithering or rounding may make is less."""
REST_MS = 400
"""Until nothing more is drawn."""


def on_screen(driver: Driver) -> np.ndarray:
    """The view's part of the screen, (height, width, 3)."""
    view = driver.window.view
    at = view.mapToGlobal(view.rect().topLeft())
    picture = QApplication.primaryScreen().grabWindow(
        0, at.x(), at.y(), view.width(), view.height()
    )
    image = picture.toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), -1)
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()


def assert_shown(driver: Driver) -> None:
    """The screen shows what the view would draw now."""
    driver.bot.wait(REST_MS)
    screen = on_screen(driver)  # first: asking the view for its pixels could mend it
    drawn = driver.window.view.pixels()
    assert screen.shape == drawn.shape
    assert (np.abs(screen.astype(int) - drawn).max(axis=2) > DIFFERENT).mean() < 1e-3


def test_every_frame_reaches_the_screen(drive: OPEN) -> None:
    driver = drive()
    before = on_screen(driver)
    for frame in (10, 0, 14):
        driver.state.seek(frame)
        driver.wait(lambda frame=frame: driver.window.controller.result.frame.index == frame)
        assert_shown(driver)
    assert (np.abs(on_screen(driver).astype(int) - before) > DIFFERENT).any()


@pytest.mark.parametrize("change", ["covered", "resized", "dock", "theme", "hidden"])
def test_the_picture_is_the_present_one_after(drive: OPEN, change: str) -> None:
    driver = drive()
    window = driver.window
    driver.seek(3)
    if change == "covered":
        above = QWidget()
        above.setGeometry(window.geometry())
        above.show()
        driver.bot.waitExposed(above)
        driver.seek(12)
        above.close()
    elif change == "resized":
        window.resize(window.width() - 130, window.height() - 70)
        driver.seek(12)
    elif change == "dock":
        window.layers_dock.hide()
        window.kappa_dock.hide()
        driver.seek(12)
    elif change == "theme":
        driver.state.choose(theme="light")
    else:
        window.hide()
        driver.state.seek(12)
        driver.wait(lambda: window.controller.result.frame.index == 12)
        window.show()
        driver.bot.waitExposed(window)
    assert_shown(driver)


def test_panels_are_painted_without_the_view(drive: OPEN) -> None:
    driver = drive()
    swapped: list[int] = []
    driver.window.view.frameSwapped.connect(lambda: swapped.append(1))
    driver.window.status.repaint()
    QApplication.processEvents()
    assert not swapped  # Qt has not put the window together anew
