"""A window and what a test does with it; a module of its own, as every folder has a conftest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from PySide6.QtCore import QPoint
from pytestqt.qtbot import QtBot

from bubbleviz.patch.patch_finder import mean_pressure
from bubbleviz.pipeline import Pipeline
from bubbleviz_ui.main_window import MainWindow
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.view3d.colour_maps import rgb

PATIENCE_MS = 240_000


@dataclass
class Driver:
    """A window and what a test does with it besides clicking."""

    bot: QtBot
    window: MainWindow

    @property
    def state(self) -> SessionState:
        return self.window.state

    @property
    def pipeline(self) -> Pipeline:
        session = self.window.controller.worker._server._session
        assert session is not None
        return session.pipeline

    def thresholded(self) -> bool:
        """Whether the patch that is shown is that of the chosen κ."""
        kappa, result = self.state.choices.kappa, self.window.controller.result
        if kappa is None or result is None or result.patch is None or result.estimate is None:
            return False
        mean = mean_pressure(self.pipeline.mesh, result.estimate.contact_pressure_pa)
        return bool(np.isclose(result.patch.threshold_pa, kappa * mean))

    def wait(self, done: Callable[[], Any]) -> None:
        self.bot.waitUntil(done, timeout=PATIENCE_MS)

    def settle(self) -> None:
        """Wait until the frame at the cursor is shown and painted."""
        result = lambda: self.window.controller.result  # noqa: E731
        # while playing the cursor is ahead of the solver, on a slow machine always
        self.wait(
            lambda: (
                result() is not None
                and (self.state.playing or result().frame.index == self.state.frame)
            )
        )
        count = self.window.view.render_count
        self.window.view.refresh()
        self.wait(lambda: self.window.view.render_count > count)

    def seek(self, frame: int) -> None:
        self.state.seek(frame)
        self.settle()

    def warm_pixels(self) -> np.ndarray:
        """Row and column of the pixels in the colours of contact pressure, (k, 2)."""
        return warm(self.window.view.pixels())


def warm(pixels: np.ndarray) -> np.ndarray:
    """Row and column of strong orange and red, left of the colour bars."""
    red, green, blue = (pixels[:, : int(0.85 * pixels.shape[1]), k].astype(int) for k in range(3))
    return np.argwhere((red > 130) & (red > 2 * blue) & (red > green + 30))


def in_view(driver: Driver, point_m: np.ndarray) -> QPoint:
    """Where a point in B is drawn, in Qt's pixels."""
    view = driver.window.view
    view.renderer.SetWorldPoint(*point_m, 1.0)
    view.renderer.WorldToDisplay()
    x, y, _ = view.renderer.GetDisplayPoint()
    return QPoint(round(x), round(view.height() - 1 - y))


def near(pixels: np.ndarray, place: QPoint, colour: str) -> bool:
    part = pixels[place.y() - 8 : place.y() + 9, place.x() - 8 : place.x() + 9]
    return bool(np.all(part == rgb(colour), axis=2).any())
