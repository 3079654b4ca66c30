"""Collection of live frames."""

from __future__ import annotations

from dataclasses import replace

from PySide6.QtWidgets import QCheckBox, QGroupBox, QHBoxLayout, QLabel, QSpinBox, QVBoxLayout

from bubbleviz.calibration import Step
from bubbleviz.recordings import Frame, HeldFrames
from bubbleviz.result import Result
from bubbleviz.wording import count_of
from bubbleviz_ui.calibration.calibration_session import Calibration
from bubbleviz_ui.engine.solver import Opened
from bubbleviz_ui.shell.dock import fill, push_button

NOTHING_OPEN = "Nothing is open: connect again (Ctrl+L) to collect frames."
NO_FRAMES = {
    "disconnected": "Disconnected: connect again (Ctrl+L) to collect frames.",
    "ended": "The source has ended: connect again (Ctrl+L) to collect frames.",
}
"""Why no frames arrive, by the badge of the source."""


class CollectBox(QGroupBox):
    """Collects the frames of a live source that are shown."""

    def __init__(self, calibration: Calibration) -> None:
        super().__init__("Collect frames")
        self._calibration, self._controller = calibration, calibration.controller
        self.frames: list[Frame] = []
        self.active = False
        self._name = ""  # Of the source
        self._fits = False  # the sensor in use has matched a contact-free frame
        self.count = QSpinBox(minimum=5, maximum=2000, value=100, suffix=" frames")
        self.contact_free = QCheckBox("Skip frames with contact")
        self.count.setToolTip("Number of frames to collect")
        self.button = push_button(
            "",
            "Collect the frames that are shown; they replace those collected before",
            self._start,
        )
        self.stop = push_button(
            "Stop and use these frames",
            "Stop collecting and calibrate with the frames collected so far",
            self._finish,
        )
        self.cancel = push_button(
            "Cancel", "Stop collecting and discard the frames collected so far", self._cancel
        )
        self.message = QLabel(wordWrap=True)
        self.contact_free.setChecked(True)
        self.contact_free.setToolTip(
            "Ticked: frames in which the sensor file in use detects contact are not collected. "
            "Unticked: all are collected, and contact-free ones are searched among them"
        )
        row = fill(QHBoxLayout(), self.count, 1)
        buttons = fill(QHBoxLayout(), self.button, self.stop, self.cancel)
        fill(QVBoxLayout(self), row, self.contact_free, buttons, self.message)
        self.count.valueChanged.connect(lambda _: self._show())
        self._controller.shown.connect(self._take)
        self._controller.state.connection_changed.connect(self._show)
        self._controller.opened.connect(self._on_opened)
        calibration.changed.connect(self._show)
        calibration.restarted.connect(self._cancel)
        self._show()

    def _start(self) -> None:
        self._controller.state.set_playing(True)
        self._name, self._fits, self.active = self._calibration.name, False, True
        self.frames = []
        self._show()

    def _take(self, result: Result) -> None:
        """Collect the frame of a result, unless it has contact or was collected already."""
        if not self.active:
            return
        only_contact_free = self.contact_free.isChecked()
        status = result.estimate.status if result.estimate is not None else None
        if status == "no_contact" and not self._fits:
            self._fits = True
            if only_contact_free:
                self.frames = []  # those before were implausible, perhaps of a deep press
        doubtful = self._fits and status in ("implausible", "not_converged")
        if status == "no_data" or (only_contact_free and (status == "ok" or doubtful)):
            return
        frame = result.frame
        if any(frame.depth_m is kept.depth_m for kept in self.frames):
            return  # the same image, shown again
        self.frames.append(frame)
        if len(self.frames) >= self.count.value():
            self._finish()
        else:
            self._show()

    def _finish(self) -> None:
        """Stop, and calibrate with these frames."""
        frames = HeldFrames(self.frames, self._name)
        self._cancel()
        if len(frames):
            ranges = ((0, len(frames)),) if self.contact_free.isChecked() else None
            settings = replace(
                self._calibration.settings, last_step=Step.TENSION, ranges=ranges, pressed=None
            )
            self._calibration.use_collected(frames, settings)

    def _cancel(self) -> None:
        self.active, self.frames = False, []
        self._show()

    def _on_opened(self, opened: Opened) -> None:
        """Continue with the same source after reconnecting; cancel with another source."""
        if self.active and not opened.facts.is_empty and opened.facts.title != self._name:
            self._cancel()
        self._show()

    def _show(self) -> None:
        state, kept = self._controller.state, self._calibration.work.collected
        why_not = NO_FRAMES.get(state.badge, "")
        if state.facts.is_empty:
            why_not = NOTHING_OPEN
        self.button.setEnabled(not why_not)
        again = "Collect" if kept is None else "Collect again:"
        self.button.setText(f"{again} {count_of(self.count.value(), 'frame')}")
        self.button.setVisible(not self.active)
        self.contact_free.setEnabled(not self.active)  # frames collected so far depend on it
        self.stop.setVisible(self.active)
        self.cancel.setVisible(self.active)
        if not self.active:
            collected = "" if kept is None else f"{count_of(len(kept), 'frame')} collected"
            if kept is not None:
                collected += "." if kept.name == self._calibration.name else f" from {kept.name}."
            self.message.setText(f"{collected} {why_not}".strip())
            return
        text = f"{len(self.frames)} of {self.count.value()} frames"
        if kept is not None:
            text += f" · until then the {count_of(len(kept), 'frame')} collected before are in use"
        self.message.setText(f"{text} {why_not}".strip())
