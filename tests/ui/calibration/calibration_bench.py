"""The γ0 panel in the real window, and what a person does with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtWidgets import QApplication, QMessageBox, QProgressDialog, QPushButton, QWidget
from window_driver import LEFT, PLAIN, Driver

from bubbleviz_ui.calibration.calibration_panel import Gamma0Panel
from bubbleviz_ui.calibration.calibration_session import Answer
from bubbleviz_ui.model.scene_presets import load_scene


class Bench(Driver):
    """The window with its γ0 panel open, and what a person does with it."""

    def __init__(self, driver: Driver) -> None:
        super().__init__(driver.bot, driver.window, driver.server)
        self.window.use_scene(load_scene("calibrate"))
        self.settle()

    @property
    def panel(self) -> Gamma0Panel:
        return self.window.gamma0

    @property
    def answer(self) -> Answer:
        return self.panel.calibration.answer

    @property
    def draft(self) -> Any:
        return self.answer.draft

    def done(self) -> None:
        self.wait(lambda: not self.panel.calibration.busy)

    def click(self, widget: QWidget, at: QPoint | None = None, *, wait: bool = True) -> None:
        super().click(widget, at)
        if wait:
            self.done()

    def step(self, number: int) -> None:
        self.click(self.panel.steps.button(number))

    def identify(self) -> None:
        self.click(self.panel.next)
        self.click(self.panel.all)
        assert not self.window.message.isVisible()

    def collect(self, count: int) -> None:
        """Collect so many live frames and wait for what follows from them."""
        box = self.panel.frames.collect
        box.count.setValue(count)
        self.click(box.button)
        self.wait(lambda: not box.collector.active)
        self.done()

    def key(
        self, which: Qt.Key, held: Qt.KeyboardModifier = PLAIN, widget: QWidget | None = None
    ) -> None:
        super().key(which, held, widget)
        self.done()

    def move_end(self, start: int, end: int) -> None:
        """Drag on the strip of the timeline, from frame to frame."""
        strip = self.panel.strip
        frames = (start, (start + end) // 2, end)
        self.drag(strip, *(QPoint(round(strip.x_of(f)), strip.height() // 2) for f in frames))
        self.done()


def answered(bench: Bench, start: Callable[[], object], button: str) -> str:
    """Click a button of the question that `start` asks; what was asked."""
    asked, timer = [], QTimer(interval=20)

    def answer() -> None:
        question = QApplication.activeModalWidget()
        if isinstance(question, QMessageBox) and not asked:
            asked.append(question.text())
            titles = {each.text().replace("&", ""): each for each in question.buttons()}
            bench.bot.mouseClick(titles[button], LEFT)

    timer.timeout.connect(answer)
    timer.start()
    start()
    bench.wait(lambda: bool(asked))
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
            bench.bot.mouseClick(waiting.findChild(QPushButton), LEFT)

    timer.timeout.connect(cancel)
    timer.start()
    yield
    assert clicked
    timer.stop()
