"""Recording of live sources; all disk access is in a thread."""

from __future__ import annotations

import time
from pathlib import Path

from PySide6.QtCore import QObject, Signal

from bubbleviz.files import free_name
from bubbleviz.live import Recorder, RecorderStatus
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.model.messages import MessageKind, Messages
from bubbleviz_ui.shell.file_dialogs import remember

DEFAULT_FOLDER = Path.home() / "bubbleviz-recordings"
"""Default folder of recordings."""


class Recording(QObject):
    """Starts and stops recordings.

    `worker`: Thread for disk access.
    """

    changed = Signal()  # A recording began or ended

    def __init__(self, worker: Worker, messages: Messages) -> None:
        super().__init__()
        self.folder = DEFAULT_FOLDER  # Created with the first recording
        self.busy = False  # Recording, or starting
        self._recorder: Recorder | None = None
        self._began = 0.0
        self._worker, self._messages = worker, messages

    def start(self, recorder: Recorder, path: Path | None = None) -> None:
        """Start recording to a new file, by default in `folder` with the time as its name."""
        path = path or new_name(self.folder)
        self.busy, self._recorder, self._began = True, recorder, time.monotonic()
        self._worker.submit(lambda: _start(recorder, path), failed=self._on_refused)
        self.changed.emit()

    def stop(self) -> None:
        """Stop recording; everything received so far is written."""
        recorder, self._recorder, self.busy = self._recorder, None, False
        if recorder is not None:
            self._worker.submit(
                lambda: recorder.stop() if recorder.recording else None,
                self._on_stopped,
                lambda failed: self._notify("error", failed.message),
            )
            self.changed.emit()

    def mark(self, text: str, at_ns: int | None = None) -> None:
        """Write a marker or note to the recording, if any."""
        recorder, when = self._recorder, time.time_ns() if at_ns is None else at_ns
        if recorder is not None:
            self._worker.submit(lambda: recorder.mark(text, when))

    @property
    def elapsed_s(self) -> float:
        """Time since the recording began."""
        return time.monotonic() - self._began

    def status(self) -> RecorderStatus | None:
        """Progress of the recording, or None. Stops it after a disk error."""
        status = None if self._recorder is None else self._recorder.status()
        if status is not None and status.problem:
            self.stop()
            return None
        return status

    def _on_refused(self, failed: Failed) -> None:
        self.busy, self._recorder = False, None
        self._notify("error", f"Not recording: {failed.message}")
        self.changed.emit()

    def _on_stopped(self, status: RecorderStatus | None) -> None:
        if status is None:
            return
        if status.problem:
            self._notify("error", status.problem)
        elif status.messages:
            size = status.size_bytes / 1e6
            text = f"Recorded {status.path}: {count_of(status.messages, 'message')}, {size:.1f} MB"
            remember("recording", Path(status.path))
            self._notify("notice", text, Path(status.path))
        else:
            self._notify(
                "warning",
                "No message arrived while recording, so no file was written; check the connection",
            )

    def _notify(self, kind: MessageKind, text: str, file: Path | None = None) -> None:
        self._messages.add(kind, text, file=file, topic="recording")


def new_name(folder: Path) -> Path:
    """Path of a new recording, named by the current time."""
    return free_name(folder / time.strftime("bubbleviz-%Y%m%d-%H%M%S.mcap"))


def make_folder(path: Path) -> None:
    """Create the folder of a recording only if it is `DEFAULT_FOLDER`."""
    if path.parent == DEFAULT_FOLDER:
        DEFAULT_FOLDER.mkdir(exist_ok=True)


def _start(recorder: Recorder, path: Path) -> None:
    make_folder(path)
    recorder.start(path)
