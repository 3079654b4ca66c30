"""Export dialog: kind, frames and file name."""

from __future__ import annotations

from PySide6.QtCore import QEvent, Qt
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.wording import count_of
from bubbleviz_ui.export.exporting import KINDS, TOPIC, Exporting, Kind
from bubbleviz_ui.model.messages import UserMessage
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import fill, push_button
from bubbleviz_ui.shell.file_dialogs import name_of_output, new_file
from bubbleviz_ui.shell.message_bars import JobProgress

RANGE, ALL = False, True
MOST_STEP = 1000  # frames
WIDTH = 460  # px


class ExportDialog(QDialog):
    """Non-modal dialog for exports."""

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
        self.frames.setToolTip("Frames to export; set a range on the timeline or with [ and ]")
        self.step = QSpinBox(minimum=1, maximum=MOST_STEP, prefix="one of ", suffix=" frames")
        self.step.setSpecialValueText("every frame")
        self.step.setToolTip("Export every frame, or one of 2, 3 … frames")
        self.captioned = QCheckBox("Frame number and time in the picture")
        self.captioned.setChecked(True)
        self.captioned.setToolTip("Written at the bottom of every picture of the video")
        self.about = theme.dim(QLabel(wordWrap=True))
        self.message = QLabel(wordWrap=True)
        self.progress = JobProgress()
        self.export = push_button(
            "Export…", "Choose the name of the file or folder, and start", self._choose_name
        )
        self.cancel = push_button("Cancel", "Stop; nothing is kept", exporting.cancel)
        which = fill(QHBoxLayout(), (self.frames, 1), self.step)
        form = QFormLayout()
        form.addRow("What", self.kind)
        form.addRow("Frames", which)
        buttons = fill(QHBoxLayout(), (self.progress, 1), 0, self.cancel, self.export)
        fill(QVBoxLayout(self), form, self.captioned, self.about, self.message, 1, buttons)
        self._connect()
        self.show_all()

    @property
    def chosen(self) -> Kind:
        kind = self.kind.currentData()
        assert isinstance(kind, Kind)
        return kind

    @property
    def chosen_frames(self) -> range:
        all_frames = self.frames.currentData() == ALL
        return self._exporting.frames(all_frames=all_frames, step=self.step.value())

    def show_all(self) -> None:
        """Update the offered frames and all texts."""
        facts, range_ = self._state.facts, self._state.play_range
        self.frames.blockSignals(True)
        self.frames.clear()
        if range_ is not None:
            self.frames.addItem(f"range on the timeline: {range_[0]} to {range_[1]}", RANGE)
        count = 0 if facts.is_empty else facts.frames
        self.frames.addItem(f"all {count_of(count, 'frame')}", ALL)
        self.frames.blockSignals(False)
        self._show()

    def event(self, event: QEvent) -> bool:
        """Grow with wrapped labels, as Qt would squeeze the widgets above them."""
        laid_out, layout = super().event(event), self.layout()
        if event.type() == QEvent.Type.LayoutRequest and layout is not None:
            needed = layout.totalHeightForWidth(self.width())
            self.resize(self.width(), max(self.height(), needed))
        return laid_out

    # -- inside -------------------------------------------------------------------------------

    def _connect(self) -> None:
        exporting = self._exporting
        self.kind.currentIndexChanged.connect(lambda _: self._show())
        self.kind.currentIndexChanged.connect(lambda _: self.message.clear())
        self.frames.currentIndexChanged.connect(lambda _: self._show())
        self.step.valueChanged.connect(lambda _: self._show())
        exporting.changed.connect(self._show)
        exporting.progressed.connect(self.progress.show_step)
        self._state.messages.added.connect(self._show_message)
        self._state.source_changed.connect(self.show_all)
        self._state.range_changed.connect(self.show_all)
        self._state.follow({"picture_size", "speed"}, self._show)

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
            self.message.clear()

    def _about(self) -> str:
        kind, count = self.chosen, len(self.chosen_frames)
        if not kind.is_video:
            return f"{kind.tip}. {count_of(count, 'frame')}."
        width, height = self._state.settings.picture_size
        fps = self._exporting.fps(self.step.value())
        return (
            f"{kind.tip}. {count_of(count, 'picture')} of {width}×{height} pixels (set in 3-D "
            f"tools, Picture), {fps:.3g} per second, at a playback speed of "
            f"{self._state.settings.speed:g}×."
        )

    def _choose_name(self) -> None:
        kind, frames = self.chosen, self.chosen_frames
        what = kind.title.lower().replace(" ", "_") + next(iter(kind.suffixes.values()), "")
        proposed = name_of_output(self._state.title, what)
        title = f"Export {kind.title.lower()}" if kind.suffixes else "Name of a new folder"
        path, chosen = new_file(self, title, proposed, kind.filters, of="export")
        if path is not None:
            named, captioned = kind.with_suffix(path, chosen), self.captioned.isChecked()
            self._exporting.start(kind, frames, named, captioned=captioned)

    def _show_message(self, message: UserMessage) -> None:
        if message.topic == TOPIC:
            self.message.setText(message.text)
