"""Driver of the calibration panel."""

from contextlib import contextmanager

from PySide6.QtCore import QPoint, QTimer
from PySide6.QtWidgets import QApplication, QMessageBox, QProgressDialog, QPushButton, QWidget
from window_driver import LEFT, PLAIN, Driver

from bubbleviz_ui.model.scene_presets import load_scene


class Bench(Driver):
    """The window with its calibration panel open, driven by clicks and keys."""

    def __init__(self, driver):
        super().__init__(driver.bot, driver.window)
        self.window.use_scene(load_scene("calibrate"))
        self.wait_until_shown()

    @property
    def panel(self):
        return self.window.calibration

    @property
    def answer(self):
        return self.panel.calibration.answer

    @property
    def found(self):
        return self.answer.found

    def done(self):
        self.wait(lambda: not self.panel.calibration.busy)

    def click(self, widget, at=None, *, wait=True):
        super().click(widget, at)
        if wait:
            self.done()

    def step(self, number):
        self.click(self.panel.steps.button(number))

    def identify(self):
        before = len(self.window.messages.all)
        self.click(self.panel.next)
        self.click(self.panel.all)
        # a warning that the sensor file does not match may come at any time
        assert "error" not in {m.kind for m in list(self.window.messages.all)[before:]}

    def collect(self, count):
        """Collect live frames and wait for the results."""
        box = self.panel.frames.collect
        box.count.setValue(count)
        self.click(box.button)
        self.wait(lambda: not box.active)
        self.done()

    def key(self, which, held=PLAIN, widget=None):
        super().key(which, held, widget)
        self.done()

    def move_end(self, start, end):
        """Drag on the range strip from frame to frame."""
        self.step(0)
        strip = self.panel.frames.strip
        frames = (start, (start + end) // 2, end)
        self.drag(strip, *(QPoint(round(strip.x_at(f)), strip.height() // 2) for f in frames))
        self.done()


def answered(bench, start, button):
    """Click a button of the question that `start` opens; returns its text."""
    asked, timer = [], QTimer(interval=20)

    def answer():
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
def cancelling(bench):
    """Click Cancel of the progress dialog of the report."""
    timer, clicked = QTimer(interval=20), list[QWidget]()

    def cancel():
        waiting = QApplication.activeModalWidget()
        if isinstance(waiting, QProgressDialog) and not clicked:
            clicked.append(waiting)
            bench.bot.mouseClick(waiting.findChild(QPushButton), LEFT)

    timer.timeout.connect(cancel)
    timer.start()
    yield
    assert clicked
    timer.stop()
