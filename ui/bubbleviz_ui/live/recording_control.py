"""Recording from the window: nothing here waits for the disk in the GUI thread."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from PySide6.QtCore import QObject, Signal

from bubbleviz.files import free_name
from bubbleviz.live import Recorder, RecorderStatus
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.model.messages import MessageKind, UserMessage
from bubbleviz_ui.shell.file_dialogs import remember

OWN_FOLDER = Path.home() / "bubbleviz-recordings"
"""Where recordings go unless another folder is chosen."""


@dataclass(frozen=True)
class RecordingState:
    """What is shown of a recording."""

    elapsed_s: float
    status: RecorderStatus


class Recording(QObject):
    """The record button's work.

    `worker`: Where it is done.
    """

    changed = Signal()  # It began or ended
    notified = Signal(object)  # A `UserMessage`

    def __init__(self, worker: Worker) -> None:
        super().__init__()
        # Where recordings go, each named by its time; `OWN_FOLDER` is made with the first
        self.folder = OWN_FOLDER
        self.busy = False  # A recording is on, or about to be
        self._recorder: Recorder | None = None
        self._began = 0.0
        self._worker = worker

    def start(self, recorder: Recorder, path: Path | None = None) -> None:
        """Begin a new file, by default one in the folder that is named by the time."""
        if self.busy:
            return
        path = path or new_name(self.folder)
        self.busy, self._recorder, self._began = True, recorder, time.monotonic()
        self._worker.submit(lambda: _start(recorder, path), failed=self._on_refused)
        self.changed.emit()

    def stop(self) -> None:
        """End it, with everything that arrived."""
        recorder, self._recorder, self.busy = self._recorder, None, False
        if recorder is not None:
            self._worker.submit(lambda: _stopped(recorder), self._on_stopped, self._on_broken)
            self.changed.emit()

    def mark(self, text: str, at_ns: int | None = None) -> None:
        """Put a marker or a note into the file; nothing where nothing is recorded."""
        recorder, when = self._recorder, time.time_ns() if at_ns is None else at_ns
        if recorder is not None:
            self._worker.submit(lambda: recorder.mark(text, when))

    def state(self) -> RecordingState | None:
        """How it goes; None while nothing is recorded. Ends a recording the disk refused."""
        status = None if self._recorder is None else self._recorder.status()
        if status is None:
            return None
        if status.problem:
            self.stop()
            return None
        return RecordingState(time.monotonic() - self._began, status)

    def _on_refused(self, failed: Failed) -> None:
        self.busy, self._recorder = False, None
        self._say("error", f"Not recording: {failed.message}")
        self.changed.emit()

    def _on_broken(self, failed: Failed) -> None:
        self._say("error", failed.message)

    def _on_stopped(self, status: RecorderStatus | None) -> None:
        if status is None:
            return
        if status.problem:
            self._say("error", status.problem)
        elif status.messages:
            size = status.size_bytes / 1e6
            text = f"Recorded {status.path}: {count_of(status.messages, 'message')}, {size:.1f} MB"
            remember("recording", Path(status.path))
            self._say("notice", text, Path(status.path))
        else:
            self._say("warning", "Nothing arrived while recording; no file was written")

    def _say(self, kind: MessageKind, text: str, file: Path | None = None) -> None:
        self.notified.emit(UserMessage(kind, text, file=file, topic="recording"))


def new_name(folder: Path) -> Path:
    """Name of a new recording, by the time."""
    return free_name(folder / time.strftime("bubbleviz-%Y%m%d-%H%M%S.mcap"))


def make_room(path: Path) -> None:
    """Make the folder of a recording, where that is `OWN_FOLDER`; no other is made unasked."""
    if path.parent == OWN_FOLDER:
        OWN_FOLDER.mkdir(exist_ok=True)


def _start(recorder: Recorder, path: Path) -> None:
    make_room(path)
    recorder.start(path)


def _stopped(recorder: Recorder) -> RecorderStatus | None:
    return recorder.stop() if recorder.recording else None
