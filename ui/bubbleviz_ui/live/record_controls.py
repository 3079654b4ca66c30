"""Record button, with what is written so far, markers and notes."""

from __future__ import annotations

import time
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QDoubleSpinBox,
    QFileDialog,
    QHBoxLayout,
    QLineEdit,
    QToolButton,
    QWidget,
)

from bubbleviz.wording import count_of
from bubbleviz_ui.live.live_controller import LiveController
from bubbleviz_ui.live.recording_control import RecordingState, new_name
from bubbleviz_ui.panels.binding import bind
from bubbleviz_ui.shell.file_dialogs import remember
from bubbleviz_ui.shell.layouts import Elided, fill

MOST_PRE_ROLL_S = 60.0  # kept in memory: 1.1 GB of 16-bit 640×480 at 30 Hz


class RecordControls(QWidget):
    """Button, pre-roll, folder; while it records elapsed time, size, messages and a note."""

    def __init__(self, live: LiveController) -> None:
        super().__init__()
        self._live = live
        self.button = QToolButton()
        self.button.setText("● Record")
        self.button.setCheckable(True)
        self.button.setToolTip("Record (Ctrl+R)")
        self.pre_roll = QDoubleSpinBox(
            minimum=0.0, maximum=MOST_PRE_ROLL_S, decimals=1, suffix=" s before"
        )
        bind(self.pre_roll, live.state, "pre_roll_s")
        self.pre_roll.setToolTip("How much of what came before the button is recorded, too")
        self.folder = QToolButton()
        self.folder.setText("Folder…")
        self.progress = Elided(Qt.TextElideMode.ElideRight, "88:88 · 888.8 MB …")
        self.note = QLineEdit()
        self.note.setPlaceholderText("Note, saved at the moment you began it")
        self.note.setMinimumWidth(100)
        self.note.setToolTip("Enter saves the note in the recording")
        self.note.hide()
        self._noted_ns: int | None = None
        fill(
            QHBoxLayout(self),
            self.progress,
            self.note,
            self.pre_roll,
            self.folder,
            self.button,
            margins=(0, 0, 0, 0),
        )
        self.folder.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.button.clicked.connect(live.toggle_recording)
        self.folder.clicked.connect(self.choose_folder)
        self.note.returnPressed.connect(self._save_note)
        self.note.editingFinished.connect(self.note.hide)
        self._show_folder()

    def show_now(self) -> None:
        """Write how the recording is going."""
        state, busy = self._live.recording.state(), self._live.recording.busy
        self._show_folder()
        self.button.setChecked(busy)
        self.button.setText("■ Stop" if busy else "● Record")
        self.button.setToolTip("End the recording (Ctrl+R)" if busy else "Record (Ctrl+R)")
        for widget in (self.pre_roll, self.folder):
            widget.setVisible(not busy)
        self.progress.setVisible(busy)
        text = "" if state is None else progress(state)
        self.progress.setText(text)
        self.progress.setToolTip(text)
        if not busy:
            self.note.hide()

    def begin_note(self) -> None:
        """Write a note about this moment."""
        if self._live.recording.busy:
            self._noted_ns = time.time_ns()
            self.note.clear()
            self.note.show()
            self.note.setFocus()

    def choose_folder(self) -> None:
        """Choose where recordings go."""
        folder = self._live.recording.folder
        present = folder if folder.is_dir() else folder.parent  # it is made with the first
        name = QFileDialog.getExistingDirectory(self, "Record into", str(present))
        if name:
            self._live.choose_folder(name)
            remember("recording", new_name(Path(name)))
            self._show_folder()

    def _save_note(self) -> None:
        text = self.note.text().strip()
        if text:
            self._live.recording.mark(text, self._noted_ns)
        self.note.clearFocus()

    def _show_folder(self) -> None:
        self.folder.setToolTip(f"Recordings go to {self._live.recording.folder}")


def progress(state: RecordingState) -> str:
    """Elapsed time, size, messages and what waits for the disk."""
    minutes, seconds = divmod(int(state.elapsed_s), 60)
    status = state.status
    return (
        f"{minutes:02d}:{seconds:02d} · {status.size_bytes / 1e6:.1f} MB · "
        f"{count_of(status.messages, 'message')} · {status.waiting_bytes / 1e6:.1f} MB waiting"
    )
