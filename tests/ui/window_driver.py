"""A window and what a test does with it; a module of its own, as every folder has a conftest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPoint, QPointF, Qt, QTimer
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QDialogButtonBox,
    QFileDialog,
    QGraphicsView,
    QLineEdit,
    QMessageBox,
    QWidget,
)
from pytestqt.qtbot import QtBot
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
from vtkmodules.vtkRenderingCore import vtkTextActor

from bubbleviz.patch.patch_finder import mean_pressure
from bubbleviz.pipeline import Pipeline
from bubbleviz_ui.engine.solver_server import Server
from bubbleviz_ui.main_window import MainWindow
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.view3d.colour_bar import WIDTH
from bubbleviz_ui.view3d.colour_maps import rgb
from bubbleviz_ui.view3d.layers.axes_layer import CORNER

PATIENCE_MS = 240_000


@dataclass
class Driver:
    """A window and what a test does with it besides clicking."""

    bot: QtBot
    window: MainWindow
    server: Server

    @property
    def state(self) -> SessionState:
        return self.window.state

    @property
    def pipeline(self) -> Pipeline:
        assert self.server.session is not None
        return self.server.session.pipeline

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
        """Have the frame at the cursor shown, settled now and not in a moment, and painted."""
        controller = self.window.controller
        self.wait(self.at_the_cursor)
        if not controller.settled:
            controller.settle()
        self.wait(lambda: self.at_the_cursor() and controller.settled)
        count = self.window.view.render_count
        self.window.view.refresh()
        self.wait(lambda: self.window.view.render_count > count)

    def at_the_cursor(self) -> bool:
        """Whether what is shown is the frame at the cursor."""
        result = self.window.controller.result
        # while playing the cursor is ahead of the solver, on a slow machine always
        return result is not None and (self.state.playing or result.frame.index == self.state.frame)

    def seek(self, frame: int) -> None:
        self.state.seek(frame)
        self.settle()

    def warm_pixels(self) -> np.ndarray:
        """Row and column of the pixels in the colours of contact pressure, (k, 2)."""
        return warm(self.window.view.pixels())


def warm(pixels: np.ndarray) -> np.ndarray:
    """Row and column of strong orange and red, left of the colour bars and not of the axes."""
    red, green, blue = (pixels[..., k].astype(int) for k in range(3))
    seen = (red > 130) & (red > 2 * blue) & (red > green + 30) & ~axes_corner(pixels)
    wide = pixels.shape[1]
    return np.argwhere(seen[:, : int(0.99 * wide - max(WIDTH, 0.11 * wide))])


def axes_corner(pixels: np.ndarray) -> np.ndarray:
    """Where the axes are in a picture, (height, width) bool."""
    corner = np.zeros(pixels.shape[:2], bool)
    corner[-CORNER:, :CORNER] = True
    return corner


def in_view(driver: Driver, point_m: np.ndarray) -> QPoint:
    """Where a point in B is drawn, in Qt's pixels."""
    return driver.window.view.place_of(point_m).toPoint()


def props(driver: Driver) -> list[Any]:
    """What VTK draws: actors and texts, the hidden ones too."""
    found = driver.window.view.renderer.GetViewProps()
    return [found.GetItemAsObject(k) for k in range(found.GetNumberOfItems())]


def texts(driver: Driver) -> list[str]:
    """Words in the 3-D view: those of the readout, and the titles of colour bars."""
    seen = [prop for prop in props(driver) if prop.GetVisibility()]
    return [text.GetInput() for text in written(driver)] + [
        prop.GetTitle() for prop in seen if isinstance(prop, vtkScalarBarActor)
    ]


def written(driver: Driver) -> list[vtkTextActor]:
    """Texts of the 3-D view that are seen, the readout's first."""
    found = [prop for prop in props(driver) if isinstance(prop, vtkTextActor)]
    return [text for text in found if text.GetVisibility() and text.GetInput()]


def drawn_points(layer: Any) -> np.ndarray:
    """Points of what a layer of the scene draws, (n, 3) in B, m."""
    return np.asarray(layer.actor.mapper.dataset.points)


def canvas(panel: QWidget) -> QGraphicsView:
    """The widget in which a panel has its plots or images, once it has been shown."""
    found = panel.findChild(QGraphicsView)
    assert isinstance(found, QGraphicsView)
    return found


def hover(widget: QWidget, place: QPoint, held: Qt.MouseButton = Qt.MouseButton.NoButton) -> None:
    """Move the mouse there, with no button held or with one."""
    at, none = QPointF(place), Qt.MouseButton.NoButton
    keys = Qt.KeyboardModifier.NoModifier
    event = QMouseEvent(QEvent.Type.MouseMove, at, widget.mapToGlobal(at), none, held, keys)
    QApplication.sendEvent(widget, event)


def idle(thing: QObject) -> bool:
    """Whether nothing of a panel, or of what serves it, is put off until later."""
    return not any(timer.isActive() for timer in thing.findChildren(QTimer))


def near(pixels: np.ndarray, place: QPoint, colour: str) -> bool:
    part = pixels[place.y() - 8 : place.y() + 9, place.x() - 8 : place.x() + 9]
    return bool(np.all(part == rgb(colour), axis=2).any())


def typed(driver: Driver, start: Callable[[], None], name: str) -> list[str]:
    """Answer the dialog that `start` opens with a name; the kinds of dialogs seen.

    A question whether a file may be replaced is answered with No, and then nothing is saved.
    """
    seen: list[str] = []
    timer = QTimer(interval=20)

    def answer() -> None:
        dialog = QApplication.activeModalWidget()
        if isinstance(dialog, QMessageBox):
            seen.append("question")
            dialog.button(QMessageBox.StandardButton.No).click()
        elif isinstance(dialog, QFileDialog) and "question" in seen:
            dialog.reject()
        elif isinstance(dialog, QFileDialog) and not seen:
            seen.append("dialog")
            dialog.findChild(QLineEdit).setText(name)  # typed, it would be completed
            kind, box = QDialogButtonBox.StandardButton, dialog.findChild(QDialogButtonBox)
            done = box.button(kind.Save) or box.button(kind.Open)
            # not here: a question would wait in it, and this timer with that
            QTimer.singleShot(0, done.click)
        elif isinstance(dialog, QDialog) and "dialog" in seen:
            dialog.reject()

    timer.timeout.connect(answer)
    timer.start()
    start()
    driver.wait(lambda: QApplication.activeModalWidget() is None)
    timer.stop()
    return seen
