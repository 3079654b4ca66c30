"""A window and what a person does with it; a module of its own, as every folder has a conftest."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PySide6.QtCore import QEvent, QMimeData, QPoint, QPointF, Qt, QTimer, QUrl
from PySide6.QtGui import QDropEvent, QImage, QMouseEvent
from PySide6.QtWidgets import (
    QApplication,
    QCheckBox,
    QDialog,
    QDialogButtonBox,
    QFileDialog,
    QGraphicsView,
    QLabel,
    QLineEdit,
    QMessageBox,
)
from pytestqt.qtbot import QtBot
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
from vtkmodules.vtkRenderingCore import vtkTextActor

from bubbleviz.inverse import mean_pressure
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.main_window import MainWindow
from bubbleviz_ui.view3d.colours import rgb
from bubbleviz_ui.view3d.sensor_layers import CORNER
from bubbleviz_ui.view3d.text import WIDTH

PATIENCE_MS = 240_000
LEFT = Qt.MouseButton.LeftButton
CTRL, SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier
PLAIN = Qt.KeyboardModifier.NoModifier
CONTACT = 75
"""A frame of the synthetic press with the object well pressed in."""
HERE = Path(__file__).parent


@dataclass
class Driver:
    """A window and what a person does with it."""

    bot: QtBot
    window: MainWindow

    @property
    def state(self):
        return self.window.state

    @property
    def solver(self):
        return self.window.controller.client.solver

    @property
    def pipeline(self):
        return self.solver.current.pipeline

    @property
    def result(self):
        """What is shown."""
        result = self.window.controller.result
        assert result is not None
        return result

    @property
    def inspection(self):
        """The closer look at it."""
        return self.window.controller.inspection

    @property
    def said(self):
        """Text of the message bar."""
        return str(self.window.message.label.text())

    def let_go(self):
        """Forget the window: pytest keeps what a fixture yields longer than the window may live."""
        vars(self).clear()

    # -- waiting ------------------------------------------------------------------------------

    def wait(self, done):
        self.bot.waitUntil(done, timeout=PATIENCE_MS)

    def told(self, *words):
        """Wait for a message with these words."""
        self.wait(lambda: self.window.message.isVisible() and all(w in self.said for w in words))

    def settle(self):
        """Have the frame at the cursor shown, settled now and not in a moment, and painted."""
        controller = self.window.controller
        self.wait(self.at_the_cursor)
        if not controller.cold_solved:
            controller.cold_solve()
        self.wait(lambda: self.at_the_cursor() and controller.cold_solved)
        self.painted_anew()

    def painted_anew(self):
        count = self.window.view.render_count
        self.window.view.refresh()
        self.wait(lambda: self.window.view.render_count > count)

    def at_the_cursor(self):
        """Whether what is shown is the frame at the cursor."""
        result = self.window.controller.result
        # while playing the cursor is ahead of the solver, on a slow machine always
        return result is not None and (self.state.playing or result.frame.index == self.state.frame)

    def thresholded(self):
        """Whether the patch that is shown is that of the chosen κ."""
        kappa, result = self.state.settings.kappa, self.window.controller.result
        if kappa is None or result is None or result.patch is None or result.estimate is None:
            return False
        mean = mean_pressure(self.pipeline.mesh, result.estimate.contact_pressure_pa)
        return bool(np.isclose(result.patch.threshold_pa, kappa * mean))

    # -- by mouse and keys --------------------------------------------------------------------

    def click(self, widget, at=None):
        """Click where a person would: check boxes on their box, all else in the middle."""
        assert widget.isEnabled()
        box = QPoint(10, widget.height() // 2) if isinstance(widget, QCheckBox) else None
        self.bot.mouseClick(widget, LEFT, pos=at or box or widget.rect().center())

    def drag(self, widget, *places):
        """Press at the first place, move to all others, and let go at the last."""
        self.bot.mousePress(widget, LEFT, pos=places[0])
        for place in places[1:]:
            self.bot.mouseMove(widget, place)
        self.bot.mouseRelease(widget, LEFT, pos=places[-1])

    def activate(self):
        with self.bot.waitActive(self.window):
            self.window.activateWindow()

    def key(self, which, held=PLAIN, widget=None):
        self.activate()
        self.bot.keyClick(widget or self.window, which, held)

    def undo(self, widget=None):
        self.key(Qt.Key.Key_Z, CTRL, widget)

    def redo(self):
        self.key(Qt.Key.Key_Z, CTRL | SHIFT)

    def type(self, box, text):
        """Replace what is in a box."""
        box.setFocus()
        box.selectAll()
        self.bot.keyClicks(box, text)
        self.bot.keyClick(box, Qt.Key.Key_Return)

    def pick(self, box, title):
        """Choose an entry by its title, with the arrow keys."""
        box.setFocus()
        self.bot.keyClick(box, Qt.Key.Key_Home)
        for _ in range(box.findText(title)):
            self.bot.keyClick(box, Qt.Key.Key_Down)
        assert box.currentText() == title

    def act(self, name):
        """Trigger an action by its name in the menus."""
        self.window.shortcuts.actions[name].trigger()

    def ticked(self, name):
        return bool(self.window.shortcuts.actions[name].isChecked())

    def drop(self, *paths, on=None):
        """Drop files on the view, or on another widget."""
        data = QMimeData()
        data.setUrls([QUrl.fromLocalFile(str(path)) for path in paths])
        action = Qt.DropAction.CopyAction
        widget = self.window.view if on is None else on
        widget.dropEvent(QDropEvent(QPointF(5, 5), action, data, LEFT, PLAIN))

    # -- what a person chooses and sees -------------------------------------------------------

    def choose(self, **settings):
        """Choose settings and wait for what they change in the picture."""
        self.state.change(**settings)
        self.settle()

    def show(self, *panels):
        for name in panels:
            self.window.panels[name].show()

    def seek(self, frame):
        self.state.seek(frame)
        self.settle()

    def opens(self, title, opener, sensor, **at):
        """Open another source in the same window; returns at once."""
        live = at.pop("live", False)
        source = opener if isinstance(opener, Source) else Source(title, opener, live=live)
        self.window.controller.opening.open(source, lambda: sensor, **at)

    def resize(self, width, height):
        self.window.resize(width, height)
        self.wait(lambda: self.size == (width, height))

    @property
    def size(self):
        return self.window.width(), self.window.height()

    def pixels(self):
        """What the 3-D view shows, (height, width, 3)."""
        return self.window.view.pixels()

    def warm_pixels(self):
        """Row and column of the pixels in the colours of contact pressure, (k, 2)."""
        return warm(self.pixels())

    def count(self, *colours):
        """How many pixels of the 3-D view have exactly each of these colours."""
        pixels = self.pixels()
        return [int(np.all(pixels == rgb(colour), axis=2).sum()) for colour in colours]

    def nodes(self):
        """Nodes of the membrane as it is shown, (n, 3) in B."""
        estimate = self.result.estimate
        assert estimate is not None
        return self.pipeline.mesh.deformed(estimate.motion_m)


def painted(widget):
    """RGB pixels of a widget as painted, (height, width, 3)."""
    return as_pixels(widget.grab().toImage())


def as_pixels(image):
    image = image.convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), -1)
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()


def clipped(root):
    """Texts of one line that are seen in a widget, and not wholly."""
    return [
        label.text()
        for label in root.findChildren(QLabel)
        if label.isVisible() and not label.wordWrap() and "<" not in label.text()
        if label.fontMetrics().horizontalAdvance(label.text()) > label.width() + 1
    ]


def copied():
    return QApplication.clipboard().text()


def warm(pixels):
    """Row and column of strong orange and red, left of the colour bars and not of the axes."""
    red, green, blue = (pixels[..., k].astype(int) for k in range(3))
    seen = (red > 130) & (red > 2 * blue) & (red > green + 30) & ~axes_corner(pixels)
    wide = pixels.shape[1]
    return np.argwhere(seen[:, : int(0.99 * wide - max(WIDTH, 0.11 * wide))])


def axes_corner(pixels):
    """Where the axes are in a picture, (height, width) bool."""
    corner = np.zeros(pixels.shape[:2], bool)
    corner[-CORNER:, :CORNER] = True
    return corner


def in_view(driver, point_m):
    """Where a point in B is drawn, in Qt's pixels."""
    return driver.window.view.screen_position(point_m).toPoint()


def props(driver):
    """What VTK draws: actors and texts, the hidden ones too."""
    found = driver.window.view.renderer.GetViewProps()
    return [found.GetItemAsObject(k) for k in range(found.GetNumberOfItems())]


def texts(driver):
    """Words in the 3-D view: those of the readout, and the titles of colour bars."""
    seen = [prop for prop in props(driver) if prop.GetVisibility()]
    return [text.GetInput() for text in written(driver)] + [
        prop.GetTitle() for prop in seen if isinstance(prop, vtkScalarBarActor)
    ]


def written(driver):
    """Texts of the 3-D view that are seen, the readout's first."""
    found = [prop for prop in props(driver) if isinstance(prop, vtkTextActor)]
    return [text for text in found if text.GetVisibility() and text.GetInput()]


def drawn_points(layer):
    """Points of what a layer of the scene draws, (n, 3) in B, m."""
    return np.asarray(layer.actor.mapper.dataset.points)


def canvas(panel):
    """The widget in which a panel has its plots or images, once it has been shown."""
    found = panel.findChild(QGraphicsView)
    assert isinstance(found, QGraphicsView)
    return found


def hover(widget, place, held=Qt.MouseButton.NoButton):
    """Move the mouse there, with no button held or with one."""
    at, none = QPointF(place), Qt.MouseButton.NoButton
    event = QMouseEvent(QEvent.Type.MouseMove, at, widget.mapToGlobal(at), none, held, PLAIN)
    QApplication.sendEvent(widget, event)


def idle(thing):
    """Whether nothing of a panel, or of what serves it, is put off until later."""
    return not any(timer.isActive() for timer in thing.findChildren(QTimer))


def near(pixels, place, colour):
    part = pixels[place.y() - 8 : place.y() + 9, place.x() - 8 : place.x() + 9]
    return bool(np.all(part == rgb(colour), axis=2).any())


def typed(driver, start, name):
    """Answer the dialog that `start` opens with a name; the kinds of dialogs seen.

    A question whether a file may be replaced is answered with No, and then nothing is saved.
    """
    seen: list[str] = []
    timer = QTimer(interval=20)

    def answer():
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


def run_python(code, *arguments, display=True, cwd=HERE.parents[1], **more):
    """Run code, to which `fakes` is known, in a process of its own."""
    hidden = () if display else ("DISPLAY", "WAYLAND_DISPLAY")
    kept = {name: value for name, value in os.environ.items() if name not in hidden}
    code = f"import sys; sys.path.insert(0, {str(HERE)!r})\n{code}"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], env={**kept, **more}, capture_output=True,
        text=True, timeout=600, check=False, cwd=cwd,
    )  # fmt: skip


def run_bubbleviz(*arguments, **more):
    """Run the program without a display: it draws for a moment and ends."""
    code = "import bubbleviz_ui.app as app; from bubbleviz.cli.command_line import main\n"
    code += "app.OFFSCREEN_SECONDS = 0.5; main()"
    return run_python(code, *map(str, arguments), display=False, **more)
