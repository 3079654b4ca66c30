"""Settings in one place, with a search; what to show is chosen in menus and panels."""

from __future__ import annotations

from PySide6.QtWidgets import (
    QCheckBox,
    QDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QVBoxLayout,
    QWidget,
)

from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.model.undo import UndoRecorder
from bubbleviz_ui.shell.binding import control, watch_controls
from bubbleviz_ui.shell.dock import fill, push_button, resize_on_screen, scrolled
from bubbleviz_ui.shell.theme import bold

SIZE = (440, 400)  # px
SECTIONS = {
    "Solver and patch": ("solver", "least_area_m2"),
    "Playback": ("speed", "every_frame", "loop"),
    "View": ("membrane_opacity", "exaggeration", "section_axis", "cloud_colour", "cloud_points"),
    "Theme and colours": ("theme", "colour_map", "pressure_max_pa", "residual_max_m"),
    "Units": ("length_unit", "pressure_unit", "force_unit", "duration_unit"),
    "Recording": ("pre_roll_s",),
}
"""Settings by heading."""


class SettingsDialog(QDialog):
    """Controls of settings; each acts at once and can be undone."""

    def __init__(self, parent: QWidget, state: SessionState, undo: UndoRecorder) -> None:
        super().__init__(parent)
        self.setWindowTitle("Settings")
        resize_on_screen(self, *SIZE)
        self._state, self._undo = state, undo
        self.search = QLineEdit(placeholderText="Find a setting", clearButtonEnabled=True)
        tip = "Set everything listed here to its default"
        self.reset = push_button("&Defaults", tip, self._reset)
        self.reset.setAutoDefault(False)
        self.controls: dict[str, QWidget] = {}  # By setting
        self.form = QFormLayout()
        for title, names in SECTIONS.items():
            self.form.addRow(bold(QLabel(title)))
            for name in names:
                self._add(name)
        inside, below = QWidget(), fill(QHBoxLayout(), 1, self.reset)
        inside.setLayout(self.form)
        fill(QVBoxLayout(self), self.search, (scrolled(inside), 1), below)
        watch_controls(self)
        self.search.setFocus()
        self.search.textChanged.connect(self._find)

    def _add(self, name: str) -> None:
        self.controls[name] = box = control(self._state, name)
        label = box.accessibleName()
        self.form.addRow("" if isinstance(box, QCheckBox) else label[:1].upper() + label[1:], box)

    def _find(self, text: str) -> None:
        """Show the settings whose label or explanation has the text, below their headings."""
        row = 0
        for names in SECTIONS.values():
            fits = [_has(name, text) for name in names]
            self.form.setRowVisible(row, any(fits))
            for k, shown in enumerate(fits):
                self.form.setRowVisible(row + 1 + k, shown)
            row += 1 + len(names)

    def _reset(self) -> None:
        default = Settings()
        with self._undo.one_step("settings"):
            self._state.change(**{name: getattr(default, name) for name in self.controls})


def _has(name: str, text: str) -> bool:
    info = Settings.info(name)
    titles = () if info.titles is None else info.titles.values()
    return text.casefold() in " ".join((info.label, info.tip, *titles)).casefold()
