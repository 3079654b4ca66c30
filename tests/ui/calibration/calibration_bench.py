"""The γ0 panel in the real window, and what a person does with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtWidgets import QApplication, QMessageBox, QProgressDialog, QPushButton, QWidget
from resting import RestingSource
from window_driver import Driver

from bubbleviz.frames.recording_writer import RecordingWriter
from bubbleviz_ui.calibration.calibration_panel import Gamma0Panel
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.playback.range_strip import RangeStrip

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton
CTRL, SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier


class Bench:
    """The window with its γ0 panel open, and what a person does with it."""

    def __init__(self, driver: Driver) -> None:
        self.driver = driver
        driver.window.use_scene(load_scene("calibrate"))
        driver.settle()

    @property
    def undone(self) -> int:
        return self.driver.window.undo_stack.index()

    @property
    def panel(self) -> Gamma0Panel:
        return self.driver.window.gamma0

    @property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        return self.panel.calibration.answer.draft.ranges

    def done(self) -> None:
        self.driver.wait(lambda: not self.panel.calibration.busy)

    def click(self, widget: QWidget, *, wait: bool = True) -> None:
        assert widget.isEnabled()
        self.driver.bot.mouseClick(widget, LEFT)
        if wait:
            self.done()

    def identify(self) -> None:
        self.click(self.panel.next)
        self.click(self.panel.all)
        assert not self.driver.window.message.isVisible()

    def key(
        self, key: Qt.Key, modifier: Qt.KeyboardModifier, widget: QWidget | None = None
    ) -> None:
        window = self.driver.window
        with self.driver.bot.waitActive(window):
            window.activateWindow()
        self.driver.bot.keyClick(widget or window, key, modifier)
        self.done()

    def undo(self) -> None:
        self.key(Qt.Key.Key_Z, CTRL)

    def redo(self) -> None:
        self.key(Qt.Key.Key_Z, CTRL | SHIFT)

    def drag(self, strip: RangeStrip, start: int, end: int) -> None:
        bot, y = self.driver.bot, strip.height() // 2
        places = [QPoint(round(strip.x_of(f)), y) for f in (start, (start + end) // 2, end)]
        bot.mousePress(strip, LEFT, pos=places[0])
        for place in places[1:]:
            bot.mouseMove(strip, place)
        bot.mouseRelease(strip, LEFT, pos=places[-1])
        self.done()


def answered(bench: Bench, start: Callable[[], object], button: str) -> str:
    """Click a button of the question that `start` asks; what was asked."""
    asked, timer = [], QTimer(interval=20)

    def answer() -> None:
        question = QApplication.activeModalWidget()
        if isinstance(question, QMessageBox) and not asked:
            asked.append(question.text())
            titles = {each.text().replace("&", ""): each for each in question.buttons()}
            bench.driver.bot.mouseClick(titles[button], LEFT)

    timer.timeout.connect(answer)
    timer.start()
    start()
    bench.driver.wait(lambda: bool(asked))
    timer.stop()
    return asked[0]


@contextmanager
def cancelling(bench: Bench) -> Iterator[None]:
    """Click Cancel of what waits for the report."""
    timer, clicked = QTimer(interval=20), list[QWidget]()

    def cancel() -> None:
        waiting = QApplication.activeModalWidget()
        if isinstance(waiting, QProgressDialog) and not clicked:
            clicked.append(waiting)
            bench.driver.bot.mouseClick(waiting.findChild(QPushButton), LEFT)

    timer.timeout.connect(cancel)
    timer.start()
    yield
    assert clicked
    timer.stop()


def record(source: RestingSource, path: Path) -> None:
    """Record all its frames."""
    with RecordingWriter(path) as writer:
        for k in range(len(source)):
            writer.write(source[k])
