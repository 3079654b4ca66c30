"""Driver of a window by mouse and keys, and helpers that read it back."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PySide6.QtCore import QEvent, QMimeData, QPoint, QPointF, Qt, QTimer, QUrl
from PySide6.QtGui import QDropEvent, QImage, QMouseEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
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
"""A frame of the synthetic press with deep contact."""
HERE = Path(__file__).parent


@dataclass
class Driver:
    """A window, driven by mouse and keys."""

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
        """Result shown."""
        return self.window.controller.result

    @property
    def inspection(self):
        """Diagnostics of the result shown."""
        return self.window.controller.inspection

    @property
    def message_text(self):
        """Text of the message bar."""
        return str(self.window.message.label.text())

    def release(self):
        """Drop all references to the window, as pytest keeps fixture values too long."""
        vars(self).clear()

    # -- waiting ------------------------------------------------------------------------------

    def wait(self, done):
        self.bot.waitUntil(done, timeout=PATIENCE_MS)

    def wait_for_message(self, *words):
        """Wait for a message with these words."""
        self.wait(
            lambda: self.window.message.isVisible() and all(w in self.message_text for w in words)
        )

    def wait_until_shown(self):
        """Wait until the frame at the cursor is shown as requested, cold-solved and painted."""
        controller = self.window.controller
        self.wait(self.shows_cursor_frame)
        if not controller.cold_solved:
            controller.cold_solve()
        self.wait(lambda: self.shows_cursor_frame() and controller.cold_solved)
        # the frame shown may be that of an earlier request, whose answer is drawn later
        unending = lambda: self.state.playing or controller.analysis.busy  # noqa: E731
        self.wait(lambda: unending() or not controller.worker.busy)
        self.wait_for_redraw()

    def wait_until_counted(self):
        """Wait until the frames solved so far are in the warnings."""
        client = self.window.controller.client
        self.wait(lambda: not (client.frames_counted.isActive() or client.worker.busy))

    def wait_until_solved_ahead(self):
        """Wait until the solver is idle: the scales cover the recording."""
        self.wait(lambda: not self.window.controller.worker.busy)
        self.wait_for_redraw()

    def wait_for_redraw(self):
        count = self.window.view.render_count
        self.window.view.refresh()
        self.wait(lambda: self.window.view.render_count > count)

    def shows_cursor_frame(self):
        """Whether the frame at the cursor is shown."""
        # during playback the cursor may always be ahead of the solver
        return self.state.playing or self.result.frame.index == self.state.frame

    def shows_chosen_kappa(self):
        """Whether the patch shown is that of the chosen κ."""
        kappa, result = self.state.settings.kappa, self.result
        if kappa is None or result.patch is None or result.estimate is None:
            return False
        mean = mean_pressure(self.pipeline.mesh, result.estimate.contact_pressure_pa)
        return bool(np.isclose(result.patch.threshold_pa, kappa * mean))

    # -- by mouse and keys --------------------------------------------------------------------

    def click(self, widget, at=None):
        """Click a widget: check boxes on their box, others in the middle."""
        assert widget.isEnabled()
        box = QPoint(10, widget.height() // 2) if isinstance(widget, QCheckBox) else None
        self.bot.mouseClick(widget, LEFT, pos=at or box or widget.rect().center())

    def drag(self, widget, *places):
        """Press at the first position, move through the others, release at the last."""
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
        """Replace the text of a box."""
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

    def trigger(self, name):
        """Trigger an action by its name in the menus."""
        self.window.shortcuts.actions[name].trigger()

    def menu(self, *titles):
        """A menu by the titles on the way to it."""
        menu = self.window.menuBar()
        for title in titles:
            menu = next(a.menu() for a in menu.actions() if a.text().replace("&", "") == title)
        return menu

    def is_checked(self, name):
        return bool(self.window.shortcuts.actions[name].isChecked())

    def drop(self, *paths):
        """Drop files on the window."""
        data = QMimeData()
        data.setUrls([QUrl.fromLocalFile(str(path)) for path in paths])
        action = Qt.DropAction.CopyAction
        self.window.dropEvent(QDropEvent(QPointF(5, 5), action, data, LEFT, PLAIN))

    # -- settings and contents ----------------------------------------------------------------

    def choose(self, **settings):
        """Change settings and wait for the result."""
        self.state.change(**settings)
        self.wait_until_shown()

    def show(self, *panels):
        for name in panels:
            self.window.panels[name].show()

    def seek(self, frame):
        self.state.seek(frame)
        self.wait_until_shown()

    def pass_by(self, frames):
        """Show frames one after another, without waiting for their cold solves."""
        for frame in frames:
            self.state.seek(frame)
            self.wait(self.shows_cursor_frame)

    def open(self, title, opener, sensor, **at):
        """Open another source in the same window; returns at once."""
        live = at.pop("live", False)
        source = opener if isinstance(opener, Source) else Source(title, opener, live=live)
        self.window.controller.opening.open(source, lambda: sensor, **at)

    def show_source(self, opener, sensor=None, **at):
        """Open another source in the same window, paused; wait until it is shown."""
        source = opener if isinstance(opener, Source) else Source("another", opener)
        self.open("", source, sensor or self.window.controller.sensor, playing=False, **at)
        opened = lambda: self.window.controller.client.opened  # noqa: E731
        self.wait(lambda: opened() is not None and opened().request.source is source)
        self.wait_until_shown()

    def resize(self, width, height):
        self.window.resize(width, height)
        self.wait(lambda: self.size == (width, height))

    def resize_to_smallest(self):
        """As in a window of 1024×700 pixels at 150 %, minus the frame."""
        self.window.resize(850, 427)
        self.wait(lambda: self.window.minimumSize().width() <= 675)
        self.resize(675, 427)

    @property
    def size(self):
        return self.window.width(), self.window.height()

    def pixels(self):
        """Picture of the 3-D view, (height, width, 3)."""
        return as_pixels(self.window.view.grabFramebuffer())

    def pressure_pixels(self):
        """Row and column of the pixels in the colours of contact pressure, (k, 2)."""
        return pressure_coloured(self.pixels())

    def count(self, *colours):
        """Number of pixels of the 3-D view with exactly each of these colours."""
        pixels = self.pixels()
        return [int(np.all(pixels == rgb(colour), axis=2).sum()) for colour in colours]

    def nodes(self):
        """Nodes of the membrane shown, (n, 3) in B."""
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


def clipped_texts(root):
    """Visible texts of labels and buttons of a widget that are clipped; wrapped ones are not."""
    texts = {}
    for each in (*root.findChildren(QLabel), *root.findChildren(QAbstractButton)):
        wraps = isinstance(each, QLabel) and each.wordWrap()
        if each.isVisible() and not wraps and "<" not in each.text():
            texts[each] = each.text().replace("&", "").splitlines()
    return [
        line
        for each, lines in texts.items()
        for line in lines
        if each.fontMetrics().horizontalAdvance(line) > each.width() + 1
    ]


def clipboard_text():
    return QApplication.clipboard().text()


def pressure_coloured(pixels):
    """Row and column of strong orange and red, left of the colour bars and not of the axes."""
    red, green, blue = (pixels[..., k].astype(int) for k in range(3))
    seen = (red > 130) & (red > 2 * blue) & (red > green + 30) & ~axes_corner(pixels)
    wide = pixels.shape[1]
    return np.argwhere(seen[:, : int(0.99 * wide - max(WIDTH, 0.11 * wide))])


def axes_corner(pixels):
    """Mask of the corner with the axes, (height, width) bool."""
    corner = np.zeros(pixels.shape[:2], bool)
    corner[-CORNER:, :CORNER] = True
    return corner


def screen_point(driver, point_m):
    """Position of a point in B in the view, in Qt pixels."""
    return driver.window.view.screen_position(point_m).toPoint()


def vtk_props(driver):
    """All VTK props, including hidden ones."""
    found = driver.window.view.renderer.GetViewProps()
    return [found.GetItemAsObject(k) for k in range(found.GetNumberOfItems())]


def view_texts(driver):
    """Visible texts of the 3-D view, including titles of colour bars."""
    seen = [prop for prop in vtk_props(driver) if prop.GetVisibility()]
    return [text.GetInput() for text in text_actors(driver)] + [
        prop.GetTitle() for prop in seen if isinstance(prop, vtkScalarBarActor)
    ]


def drawn_curve(plot, quantity):
    """Times in s and values of a curve of a plot over time, as drawn."""
    return plot.curves[quantity].getOriginalDataset()


def colour_bar(driver, quantity):
    """The colour bar of a quantity."""
    bars = (prop for prop in vtk_props(driver) if isinstance(prop, vtkScalarBarActor))
    (bar,) = (bar for bar in bars if quantity in bar.GetTitle())
    return bar


def text_actors(driver):
    """Visible text actors of the 3-D view, the readout's first."""
    found = [prop for prop in vtk_props(driver) if isinstance(prop, vtkTextActor)]
    return [text for text in found if text.GetVisibility() and text.GetInput()]


def drawn_points(layer):
    """Points drawn by a layer of the scene, (n, 3) in B, m."""
    return np.asarray(layer.actor.mapper.GetInput().points)


def graphics_view(panel):
    """The graphics view of a panel that has been shown."""
    found = panel.findChild(QGraphicsView)
    assert isinstance(found, QGraphicsView)
    return found


def hover(widget, place, held=Qt.MouseButton.NoButton):
    """Move the mouse to a position, optionally with a pressed button."""
    at, none = QPointF(place), Qt.MouseButton.NoButton
    event = QMouseEvent(QEvent.Type.MouseMove, at, widget.mapToGlobal(at), none, held, PLAIN)
    QApplication.sendEvent(widget, event)


def turn_wheel(widget, notches, place=None, held=PLAIN):
    """Turn the mouse wheel over a position in a widget, its middle by default."""
    window = widget.window()
    place = QPointF(widget.mapTo(window, place or widget.rect().center()))
    turn = QPoint(0, notches * 120)
    QTest.wheelEvent(window.windowHandle(), place, turn, stateKey=held)
    QApplication.processEvents()


def no_pending_timers(thing):
    """Whether no timer of an object is pending."""
    return not any(timer.isActive() for timer in thing.findChildren(QTimer))


def near(pixels, place, colour):
    part = pixels[place.y() - 8 : place.y() + 9, place.x() - 8 : place.x() + 9]
    return bool(np.all(part == rgb(colour), axis=2).any())


def answer_file_dialog(driver, start, name):
    """Answer the file dialog that `start` opens with a name; returns the kinds of dialogs seen.

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
            dialog.findChild(QLineEdit).setText(name)  # typing would complete it
            kind, box = QDialogButtonBox.StandardButton, dialog.findChild(QDialogButtonBox)
            done = box.button(kind.Save) or box.button(kind.Open)
            # later, as a question would block this timer
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
    """Run code that can import `fakes` in a separate process."""
    hidden = () if display else ("DISPLAY", "WAYLAND_DISPLAY")
    kept = {name: value for name, value in os.environ.items() if name not in hidden}
    code = f"import sys; sys.path.insert(0, {str(HERE)!r})\n{code}"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], env={**kept, **more}, capture_output=True,
        text=True, timeout=600, check=False, cwd=cwd,
    )  # fmt: skip


def run_bubbleviz(*arguments, **more):
    """Run the program without a display for a moment."""
    code = "import bubbleviz_ui.app as app; from bubbleviz.cli.command_line import main\n"
    code += "app.OFFSCREEN_SECONDS = 0.5; main()"
    return run_python(code, *map(str, arguments), display=False, **more)
