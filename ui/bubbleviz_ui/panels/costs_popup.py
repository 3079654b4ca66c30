"""Pop-up of the status bar: what runs, what it costs, and why it runs."""

from __future__ import annotations

from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QAbstractItemView,
    QFrame,
    QHeaderView,
    QLabel,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.wording import count_of
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.costs import Cost, Costs
from bubbleviz_ui.model.registry import ASKING, LAYERS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.layouts import fill
from bubbleviz_ui.view3d.render_view import View

EVERY_MS = 500  # twice a second, as can be read
COLUMNS = ("Stage", "last", "median", "runs", "Why it runs")
WIDTH = 860  # px: all columns
NOBODY = "nobody asks: it does not run"


class CostsPopup(QFrame):
    """Table of the stages; follows while it is open."""

    def __init__(
        self, parent: QWidget, state: SessionState, controller: Controller, costs: Costs, view: View
    ) -> None:
        super().__init__(parent, Qt.WindowType.Popup)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setObjectName("costs")
        self._state, self._controller, self._costs, self._view = state, controller, costs, view
        self.table = QTableWidget(0, len(COLUMNS))
        self.drawing = QLabel()
        self.hint = QLabel("Hide a layer or close a panel, and what only it asked for stops.")
        self.hint.setObjectName("dim")
        self._lay_out()
        self._timer = QTimer(self, interval=EVERY_MS)
        self._timer.timeout.connect(lambda: self.refresh())
        self._timer.start()
        self.refresh()

    def open_over(self, bar: QWidget) -> None:
        """Appear above the right end of the status bar."""
        corner = bar.mapToGlobal(QPoint(bar.width(), 0))
        self.adjustSize()
        self.move(corner.x() - self.width() - 8, corner.y() - self.height() - 4)
        self.show()

    def refresh(self) -> None:
        """Write the numbers of now."""
        analysing = self._controller.analysis.busy
        counts = self._controller.worker.counts
        lines = self._costs.table(self._state.choices, counts, analysing=analysing)
        self.table.setRowCount(len(lines))
        for row, line in enumerate(lines):
            for column, text in enumerate(self._texts(line)):
                self._write(row, column, text, idle=not line.why and line.stage != "total")
        height = self.table.horizontalHeader().height() + 2
        self.table.setFixedHeight(height + sum(self.table.rowHeight(r) for r in range(len(lines))))
        view, duration = self._view, self._state.units.duration
        each = 1e3 * view.busy_s / view.render_count if view.render_count else None
        self.drawing.setText(
            f"Drawing: {duration.text(each)} a picture, {count_of(view.render_count, 'picture')},"
            f" {count_of(self._controller.dropped, 'frame')} left out because a newer one was there"
        )

    def _texts(self, line: Cost) -> tuple[str, ...]:
        duration = self._state.units.duration
        why = ", ".join(map(_title, line.why)) or ("" if line.stage == "total" else NOBODY)
        last, typical = duration.text(line.last_ms), duration.text(line.median_ms)
        return line.title, last, typical, f"{line.runs}×", why

    def _write(self, row: int, column: int, text: str, *, idle: bool) -> None:
        item = self.table.item(row, column)
        if item is None:
            item = QTableWidgetItem()
            self.table.setItem(row, column, item)
            if 0 < column < len(COLUMNS) - 1:
                side = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
                item.setTextAlignment(side)
        item.setText(text)
        item.setToolTip(text)
        colours = theme.of(self)
        item.setForeground(QColor(colours.dim if idle else colours.text))

    def _lay_out(self) -> None:
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.setFixedWidth(WIDTH)
        title = QLabel("What runs and what it costs")
        title.setObjectName("value")
        table = self.table
        table.setHorizontalHeaderLabels(COLUMNS)
        table.verticalHeader().hide()
        table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        table.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        table.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        header = table.horizontalHeader()
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setSectionResizeMode(len(COLUMNS) - 1, QHeaderView.ResizeMode.Stretch)
        fill(QVBoxLayout(self), title, table, self.drawing, self.hint)


def _title(name: str) -> str:
    """What a layer or panel that asks is called."""
    if name in LAYERS:
        return LAYERS[name].title
    panel = ASKING.get(name)
    if panel is None:
        return name
    return f"{panel.title} panel" if panel.side else panel.title.lower()
