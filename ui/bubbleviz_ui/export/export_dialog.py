"""The dialog that exports: what, of which frames, under which name."""

from __future__ import annotations

from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QValidator
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.wording import count_of
from bubbleviz_ui.export.exporting import KINDS, Exporting, Kind
from bubbleviz_ui.model.messages import UserMessage
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.shell.dock import fill
from bubbleviz_ui.shell.file_dialogs import new_file

RANGE, ALL = False, True
MOST_STEP = 1000  # frames
WIDTH = 460  # px: a path of usual length


class StepBox(QSpinBox):
    """Shows 2 as 2nd; reads it with its ending or without."""

    def textFromValue(self, value: int) -> str:
        """2 as 2nd."""
        usual = {1: "st", 2: "nd", 3: "rd"}.get(value % 10, "th")
        return f"{value}{'th' if value % 100 in (11, 12, 13) else usual}"

    def valueFromText(self, text: str) -> int:
        """2nd as 2."""
        return int(_digits(text) or 1)

    def validate(self, text: str, position: int) -> tuple[QValidator.State, str, int]:
        """Anything with a number in range may be typed."""
        inside = 1 <= int(_digits(text) or 0) <= MOST_STEP
        state = QValidator.State.Acceptable if inside else QValidator.State.Intermediate
        return state, text, position


class ExportDialog(QDialog):
    """Stays open beside the window, which can be used meanwhile."""

    def __init__(self, parent: QWidget, state: SessionState, exporting: Exporting) -> None:
        super().__init__(parent)
        self.setWindowTitle("Export")
        self.setMinimumWidth(WIDTH)
        self._state, self._exporting = state, exporting
        self.kind = QComboBox()
        for row, kind in enumerate(KINDS):
            self.kind.addItem(kind.title, kind)
            self.kind.setItemData(row, kind.tip, Qt.ItemDataRole.ToolTipRole)
        self.kind.setToolTip("What to export")
        self.frames = QComboBox()
        self.frames.setToolTip("Set the range on the timeline or with [ and ]")
        self.step = StepBox(minimum=1, maximum=MOST_STEP, prefix="every ", suffix=" frame")
        self.step.setSpecialValueText("every frame")
        self.step.setToolTip("Export every frame, every 2nd, every 3rd …")
        self.captioned = QCheckBox("Frame number and time in the picture")
        self.captioned.setChecked(True)
        self.captioned.setToolTip("Written at the bottom of every picture of the video")
        self.about = QLabel(wordWrap=True)
        self.about.setObjectName("dim")
        self.said = QLabel(wordWrap=True)
        self.progress = QProgressBar(minimum=0, maximum=100)
        self.export, self.cancel = QPushButton("Export…"), QPushButton("Cancel")
        self.export.setToolTip("Choose a file name and start")
        self.cancel.setToolTip("Stop and remove the unfinished files")
        self._lay_out()
        self._connect()
        self.show_all()

    @property
    def chosen(self) -> Kind:
        """What is to be made."""
        kind = self.kind.currentData()
        assert isinstance(kind, Kind)
        return kind

    @property
    def chosen_frames(self) -> range:
        """Frames to make it of."""
        all_of_them = self.frames.currentData() == ALL
        return self._exporting.frames(all_of_them=all_of_them, step=self.step.value())

    def show_all(self) -> None:
        """Say what can be exported now."""
        self._offer_frames()
        self._show()

    def event(self, event: QEvent) -> bool:
        """Grow with the texts: Qt squeezes what is above a wrapped label that gets longer."""
        laid_out, layout = super().event(event), self.layout()
        if event.type() == QEvent.Type.LayoutRequest and layout is not None:
            needed = layout.totalHeightForWidth(self.width())
            self.resize(self.width(), max(self.height(), needed))
        return laid_out

    # -- inside -------------------------------------------------------------------------------

    def _lay_out(self) -> None:
        which = fill(QHBoxLayout(), (self.frames, 1), self.step)
        form = QFormLayout()
        form.addRow("What", self.kind)
        form.addRow("Frames", which)
        buttons = fill(QHBoxLayout(), (self.progress, 1), 0, self.cancel, self.export)
        fill(QVBoxLayout(self), form, self.captioned, self.about, self.said, 1, buttons)

    def _connect(self) -> None:
        exporting = self._exporting
        self.kind.currentIndexChanged.connect(lambda _: self._show())
        self.frames.currentIndexChanged.connect(lambda _: self._show())
        self.step.valueChanged.connect(lambda _: self._show())
        self.export.clicked.connect(lambda: self._choose_name())
        self.cancel.clicked.connect(exporting.cancel)
        exporting.changed.connect(self._show)
        exporting.progressed.connect(self._on_progress)
        exporting.notified.connect(self._say)
        self._state.source_changed.connect(self.show_all)
        self._state.range_changed.connect(self.show_all)
        self._state.settings_changed.connect(self._on_settings)

    def _on_settings(self, names: frozenset[str]) -> None:
        if names & {"picture_size", "speed"}:
            self._show()

    def _offer_frames(self) -> None:
        """Offer the range on the timeline, where there is one, and all frames."""
        facts, range_ = self._state.facts, self._state.play_range
        self.frames.blockSignals(True)
        self.frames.clear()
        if range_ is not None:
            self.frames.addItem(f"range on the timeline: {range_[0]} to {range_[1]}", RANGE)
        count = 0 if facts is None or facts.is_empty else facts.frames
        self.frames.addItem(f"all {count_of(count, 'frame')}", ALL)
        self.frames.blockSignals(False)

    def _show(self) -> None:
        why_not, busy = self._exporting.why_not(), self._exporting.busy
        self.captioned.setVisible(self.chosen.is_video)
        for widget in (self.kind, self.frames, self.step, self.captioned):
            widget.setEnabled(not busy)
        self.export.setEnabled(not busy and not why_not)
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self.about.setText(why_not or self._about())
        if busy:
            self.said.clear()

    def _about(self) -> str:
        kind, count = self.chosen, len(self.chosen_frames)
        if not kind.is_video:
            return f"{kind.tip}. {count_of(count, 'frame')}."
        width, height = self._state.settings.picture_size
        fps = self._exporting.fps(self.step.value())
        return (
            f"{kind.tip}. {count_of(count, 'picture')} of {width}×{height} (3-D tools, Picture), "
            f"{fps:.3g} per second, as in playback at {self._state.settings.speed:g}×."
        )

    def _choose_name(self) -> None:
        kind, frames = self.chosen, self.chosen_frames
        proposed = kind.title.lower().replace(" ", "_") + next(iter(kind.suffixes.values()), "")
        title = f"Export {kind.title.lower()}" if kind.suffixes else "Name of a new folder"
        path, chosen = new_file(self, title, proposed, kind.filters, of="export")
        if path is not None:
            named, captioned = kind.named(path, chosen), self.captioned.isChecked()
            self._exporting.start(kind, frames, named, captioned=captioned)

    def _on_progress(self, step: str, done: float) -> None:
        self.progress.setFormat(f"{step} %p %")
        self.progress.setValue(round(100.0 * done))

    def _say(self, message: UserMessage) -> None:
        self.said.setText(message.text)


def _digits(text: str) -> str:
    return "".join(letter for letter in text if letter.isdigit())
