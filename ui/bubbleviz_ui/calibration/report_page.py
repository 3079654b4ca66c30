"""Last step: verdict, the new sensor beside the one in use, use it, save it."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QLabel,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
)

from bubbleviz_ui.calibration.calibration_answer import Answer
from bubbleviz_ui.calibration.calibration_page import Page
from bubbleviz_ui.calibration.calibration_session import Calibration
from bubbleviz_ui.calibration.image_view import ImageView
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.shell.file_dialogs import new_file
from bubbleviz_ui.shell.layouts import fill

if TYPE_CHECKING:
    from bubbleviz.calibration.sensor_comparison import Comparison, Kind


class ReportPage(Page):
    """What the identification is worth, and what to do with it.

    Attributes
    ----------
    use : Signal
        Open the identified sensor on the present source.
    save : Signal
        Path of the sensor file to write.
    use_it, save_as : QPushButton
        The panel has them where the other steps have theirs.
    """

    name = "Report"
    title = "Report"
    todo = "Compare with the sensor in use, then save the new one, or use it now."
    next_title = "Compare and save"
    use = Signal()
    save = Signal(object)

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.advice = QLabel(wordWrap=True)
        self.advice.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.compared = QLabel(wordWrap=True)
        self.table = QTableWidget(0, 3)
        self.table.setHorizontalHeaderLabels(["", "in use", "new"])
        self.view = ImageView("around zero")
        self.use_it = QPushButton("Use it")
        self.save_as = QPushButton("Save sensor as…")
        self.save_as.setObjectName("main")
        self._lay_out()
        self.use_it.clicked.connect(self.use)
        self.save_as.clicked.connect(self.choose_file)

    def is_done(self, answer: Answer) -> bool:
        """Whether the sensor file of this answer was saved."""
        return self.calibration.saved == answer.work

    def show_answer(self, answer: Answer) -> None:
        """Show verdict, table and difference."""
        verdict, comparison = answer.verdict(self.units), answer.comparison
        ready = not self.calibration.busy and not self.calibration.outdated
        for button in (self.use_it, self.save_as):
            button.setEnabled(comparison is not None and ready)
        advice = "" if verdict is None else "\n".join(f"• {line}" for line in verdict.advice)
        self.advice.setText(advice)
        old = answer.compared_with
        self.compared.setText(f"In use: {old.name}" if old is not None else "")
        self._show_table(comparison)
        length = self.units.fine_length
        difference = comparison.difference_m if comparison is not None else None
        limit = comparison.largest_m if comparison is not None else 1e-3
        self.view.show_image(
            "Range expected of the untouched membrane, new minus in use",
            difference, length, -limit, limit)  # fmt: skip

    def _show_table(self, comparison: Comparison | None) -> None:
        rows = comparison.rows if comparison is not None else ()
        self.table.setRowCount(len(rows))
        for number, row in enumerate(rows):
            unit = self._unit(row.kind)
            old = unit.with_interval(row.old, row.old_half_width)
            new = unit.with_interval(row.new, row.half_width)
            for column, text in enumerate((row.name, old, new)):
                self.table.setItem(number, column, QTableWidgetItem(text.rstrip()))
        height = self.table.horizontalHeader().height() + 4
        height += sum(self.table.rowHeight(k) for k in range(len(rows)))
        self.table.setFixedHeight(height)

    def _unit(self, kind: Kind) -> Unit:
        units = self.units
        by_kind: dict[Kind, Unit] = {
            "tension": units.tension,
            "pressure": units.gas_pressure,
            "length": units.length,
            "fine length": units.fine_length,
            "volume": units.volume,
            "area": units.area,
            "count": Unit("pixels", 1.0, 0),
            "number": Unit("", 1.0, 3),
        }
        return by_kind[kind]

    def choose_file(self) -> None:
        """Ask for the name of a sensor file, and have it written."""
        proposed, kinds = own_name(self.calibration.name), "Sensor files (*.toml)"
        path, _ = new_file(self, "Save sensor as", proposed, kinds, of="sensor")
        if path is not None:
            self.save.emit(path)

    def _lay_out(self) -> None:
        table = self.table
        table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        table.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        table.setToolTip("±: half of the 95 % interval, where it is known")
        table.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        table.verticalHeader().hide()
        table.verticalHeader().setDefaultSectionSize(22)
        header = table.horizontalHeader()
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        table.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        fill(self.column, self.compared, self.table, self.view, self.advice, 1)
        self.use_it.setToolTip("Open the new sensor on the present source; undo goes back")
        self.save_as.setToolTip("Sensor file, mesh, pixels and report, all or nothing")


def own_name(source: str) -> str:
    """File name for an identified sensor, by what it was identified from and the day."""
    stem = re.sub(r"[^\w-]+", "_", Path(source).stem).strip("_") or "sensor"
    return f"{stem}_{time.strftime('%Y-%m-%d')}.toml"
