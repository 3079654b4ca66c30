"""Statistics of the curves over the range on the timeline, to read and to copy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
)

from bubbleviz.diagnostics.range_statistics import Statistics, statistics
from bubbleviz_ui.model.units import NOTHING, Unit

ROW = 18  # px: a line of text
NUMBERS = {
    "mean": "mean",
    "standard_deviation": "standard deviation",
    "minimum": "minimum",
    "maximum": "maximum",
}
COPIED_DIGITS = 6


@dataclass(frozen=True)
class Curve:
    """What a column is about.

    Attributes
    ----------
    title : str
    unit : Unit
    values : (n,) array
        In SI, of the frames in the range; NaN where nothing is known.
    """

    title: str
    unit: Unit
    values: np.ndarray


class RangeTable(QTableWidget):
    """A column for each curve; hidden while no range is marked.

    Attributes
    ----------
    copy : QPushButton
        Copies the table; to be put where there is room, and seen as long as the table is.
    """

    def __init__(self) -> None:
        super().__init__()
        self.copy = QPushButton("Copy table")
        self.copy.setToolTip("Copy mean, spread and extremes over the range, for a spreadsheet")
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.verticalHeader().setMinimumSectionSize(ROW)
        self.verticalHeader().setDefaultSectionSize(ROW)
        self.setRowCount(len(NUMBERS) + 1)
        self.setVerticalHeaderLabels([*NUMBERS.values(), "frames"])
        self._text = ""
        self.copy.clicked.connect(lambda: QApplication.clipboard().setText(self._text))
        self.show_range(0, 0, [], None, "")

    def show_range(
        self, first: int, last: int, curves: Sequence[Curve], kappa: float | None, sensor: str
    ) -> None:
        """Show the statistics of curves over the frames `first` to `last`; none: nothing.

        What nothing is known of is left out, such as a wrench that was not measured. κ, None where
        it is automatic, and the sensor are in the copied table alone.
        """
        columns = [(curve, statistics(curve.values)) for curve in curves]
        columns = [column for column in columns if column[1].frames] or columns
        made_by = ("" if kappa is None else f"{kappa:g}", sensor)
        text = _as_text(f"Frames {first} to {last}", columns, made_by)
        if text == self._text:
            return
        self._text = text
        self.setColumnCount(len(columns))
        self.setHorizontalHeaderLabels([_heading(curve) for curve, _ in columns])
        for k, (curve, known) in enumerate(columns):
            for row, text in enumerate(_shown(curve, known)):
                item = QTableWidgetItem(text)
                item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                self.setItem(row, k, item)
        self._fit()
        for widget in (self, self.copy):
            widget.setVisible(bool(columns))

    def _fit(self) -> None:
        """As high as its rows are."""
        self.resizeColumnsToContents()
        bar = self.horizontalScrollBar().sizeHint().height()
        head = self.horizontalHeader().sizeHint().height()
        rows = self.verticalHeader().length()
        self.setFixedHeight(head + rows + bar + 2 * self.frameWidth())


def _heading(curve: Curve) -> str:
    return f"{curve.title} ({curve.unit.symbol})"


def _shown(curve: Curve, known: Statistics) -> list[str]:
    """One decimal more than single values have."""
    numbers = [curve.unit.of(getattr(known, name)) for name in NUMBERS]
    digits = curve.unit.digits + 1
    texts = [f"{value:.{digits}f}" if np.isfinite(value) else NOTHING for value in numbers]
    frames = len(curve.values)
    return [*texts, str(frames) if known.frames == frames else f"{known.frames} of {frames}"]


def _as_text(
    title: str, columns: Sequence[tuple[Curve, Statistics]], made_by: tuple[str, str]
) -> str:
    """The table as spreadsheets take it; a cell is empty where there is no number."""
    lines = [[title, *(_heading(curve) for curve, _ in columns), "κ", "sensor"]]
    for name, words in NUMBERS.items():
        values = [curve.unit.of(getattr(known, name)) for curve, known in columns]
        lines.append(
            [words, *(f"{v:.{COPIED_DIGITS}g}" if np.isfinite(v) else "" for v in values), *made_by]
        )
    lines.append(["frames", *(str(known.frames) for _, known in columns), *made_by])
    return "\n".join("\t".join(line) for line in lines)
