"""List of the contacts of the open source."""

from __future__ import annotations

from PySide6.QtWidgets import QDialog, QLabel, QVBoxLayout, QWidget

from bubbleviz.wording import count_of
from bubbleviz_ui.model.frame_history import ContactPeriod
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.throttle import Throttle
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import fill, resize_on_screen
from bubbleviz_ui.shell.table import Table

SIZE = (430, 320)  # px
EVERY_MS = 500
"""Period of updates while frames are computed."""
COLUMNS = ("Start", "Duration", "Frames", "Largest force")


class ContactsDialog(QDialog):
    """All contacts so far; a click on one shows the frame of its largest force."""

    def __init__(self, parent: QWidget, state: SessionState) -> None:
        super().__init__(parent)
        self.setWindowTitle("Contacts")
        resize_on_screen(self, *SIZE)
        self._state = state
        self._contacts: tuple[ContactPeriod, ...] = ()
        self.table = Table(COLUMNS, len(COLUMNS) - 1)
        self.table.setToolTip("Click: show the frame of the largest force")
        self.note = theme.dim(QLabel(wordWrap=True))
        fill(QVBoxLayout(self), (self.table, 1), self.note)
        self.table.cellClicked.connect(self._seek)
        update = Throttle(self, self._show, EVERY_MS)
        state.history_changed.connect(update.request)
        state.settings_changed.connect(update.request)
        state.source_changed.connect(self._show)
        self._show()

    def _show(self) -> None:
        state, facts, units = self._state, self._state.facts, self._state.units
        self._contacts = state.history.contacts()
        self.table.setRowCount(len(self._contacts))
        for row, each in enumerate(self._contacts):
            start_s, end_s = (float(facts.times_s[frame]) for frame in (each.first, each.last))
            texts = (
                units.time.text(start_s),
                units.time.text(end_s - start_s),
                f"{each.first}–{each.last}",
                f"{units.force.text(each.force_n)} in frame {each.largest}",
            )
            self.table.write(row, texts, right=range(len(COLUMNS)))
        missing = state.left_to_analyse
        note = f"{count_of(missing, 'frame')} not yet computed; run Analyse all frames"
        self.note.setText(note)
        self.note.setVisible(missing > 0)

    def _seek(self, row: int, _: int) -> None:
        self._state.step(self._contacts[row].largest - self._state.frame)
