"""Docks that become tabs of others when they are opened, and panels that scroll when short."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from PySide6.QtCore import QEvent, QObject, QRect, QSize, Qt, Signal
from PySide6.QtGui import QPainter, QPaintEvent
from PySide6.QtWidgets import (
    QBoxLayout,
    QDockWidget,
    QFrame,
    QLabel,
    QLayout,
    QLayoutItem,
    QMainWindow,
    QScrollArea,
    QStyle,
    QWidget,
)

from bubbleviz_ui.model.session_state import SessionState


class Dock(QDockWidget):
    """Panel at the window's edge.

    Tabs are made just before they are seen: Qt draws those of docks that were never shown, and a
    dock that is shown before it is a tab makes the window grow.
    """

    _neighbour: QDockWidget | None = None
    _narrower_than: int | None = None
    _high = _takes_all = False

    def open_high(self) -> None:
        """Open as high as the panel asks to be, where there is room; else it would be lowest."""
        self._high = True

    def take_free_height(self) -> None:
        """Take what others in its column do not need whenever it is opened."""
        self._takes_all = True

    def tab_of(self, neighbour: QDockWidget, narrower_than: int | None = None) -> None:
        """Open as a tab of another dock, unless the user has moved it elsewhere.

        `narrower_than`: Only in a window that is less wide, screen pixels.
        """
        self._neighbour, self._narrower_than = neighbour, narrower_than

    def setVisible(self, visible: bool) -> None:
        """Become a tab first, the first time."""
        window, neighbour, limit = self.parentWidget(), self._neighbour, self._narrower_than
        first = visible and neighbour is not None
        if first and neighbour is not None and isinstance(window, QMainWindow):
            self._neighbour = None
            first = limit is None or window.width() < limit
            if first:
                window.tabifyDockWidget(neighbour, self)
        super().setVisible(visible)
        if first:
            self.raise_()
        if visible and self._high and isinstance(window, QMainWindow):
            self._high = False
            window.resizeDocks([self], [self.sizeHint().height()], Qt.Orientation.Vertical)
        if visible and self._takes_all and isinstance(window, QMainWindow):
            area, mine = window.dockWidgetArea(self), [self, *window.tabifiedDockWidgets(self)]
            others = [
                dock
                for dock in window.findChildren(QDockWidget)
                if window.dockWidgetArea(dock) == area and dock not in mine and dock.isVisible()
            ]
            heights = [window.height(), *(1 for _ in others)]
            window.resizeDocks([self, *others], heights, Qt.Orientation.Vertical)


def scrolled(panel: QWidget) -> QScrollArea:
    """Panel that scrolls up and down where it is too short, so that the window need not grow."""
    area = QScrollArea()
    area.setWidget(panel)
    area.setWidgetResizable(True)
    area.setFrameShape(QFrame.Shape.NoFrame)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    bar = area.style().pixelMetric(QStyle.PixelMetric.PM_ScrollBarExtent)
    area.setMinimumWidth(panel.minimumSizeHint().width() + bar)
    return area


# Which panels are open: what a person opens and closes, not which tab is in front.


STATUS = "status"


class OpenPanels(QObject):
    """Panels of the window by their names in scene presets."""

    changed = Signal()  # A panel was opened or closed
    _status_changed = Signal()

    def __init__(self, panels: Mapping[str, QWidget], state: SessionState, parent: QObject) -> None:
        super().__init__(parent)
        self._status_changed.connect(self._note_status)
        self._panels, self._state = panels, state
        for panel in panels.values():
            panel.installEventFilter(self)

    @property
    def names(self) -> frozenset[str]:
        """Those that are open."""
        return frozenset(name for name, panel in self._panels.items() if not panel.isHidden())

    def show_only(self, names: frozenset[str]) -> None:
        """Open these and close the others."""
        for name, panel in self._panels.items():
            panel.setVisible(name in names)

    def close(self) -> None:
        """Watch no more: the window takes its panels down one by one."""
        for panel in self._panels.values():
            panel.removeEventFilter(self)

    def _note_status(self) -> None:
        """Docks ask for what they show while they are in front; the status bar always is."""
        self._state.set_panel_open(STATUS, STATUS in self.names)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Notice that somebody has opened or closed one; hiding the window closes none."""
        if event.type() in (QEvent.Type.ShowToParent, QEvent.Type.HideToParent):
            if watched is self._panels[STATUS]:
                self._status_changed.emit()
            self.changed.emit()
        return False


# Layouts, filled in one statement; bars and labels that fit where there is little room.


LEAST_TEXT = 240
"""Width that a long text has at least beside controls, screen pixels."""

Item = QWidget | QLayout | int
B = TypeVar("B", bound=QBoxLayout)


def fill(
    layout: B,
    *items: Item | tuple[Item, int],
    margins: tuple[int, int, int, int] | None = None,  # Left, top, right and bottom, screen pixels
    spacing: int | None = None,  # Between the items, screen pixels
) -> B:
    """Fill a row or a column.

    `items`: One after the other; with its stretch where it has one. A number alone is a stretch.
    """
    if margins is not None:
        layout.setContentsMargins(*margins)
    if spacing is not None:
        layout.setSpacing(spacing)
    for item in items:
        inner, stretch = item if isinstance(item, tuple) else (item, 0)
        if isinstance(inner, QWidget):
            layout.addWidget(inner, stretch)
        elif isinstance(inner, QLayout):
            layout.addLayout(inner, stretch)
        else:
            layout.addStretch(inner)
    return layout


class BarLayout(QLayout):
    """A text with controls beside it; below it, in rows, where both have no room."""

    def __init__(
        self,
        parent: QWidget,
        text: QWidget,
        *controls: QWidget,
        margins: tuple[int, int, int, int],  # Left, top, right and bottom, screen pixels
    ) -> None:
        super().__init__(parent)
        self._items: list[QLayoutItem] = []
        self.setContentsMargins(*margins)
        self.setSpacing(6)
        for widget in (text, *controls):
            self.addWidget(widget)

    def addItem(self, item: QLayoutItem) -> None:
        """Add at the end."""
        self._items.append(item)

    def count(self) -> int:
        """Of text and controls, the hidden ones too."""
        return len(self._items)

    def itemAt(self, index: int) -> QLayoutItem | None:
        """Nothing beyond the last, as Qt wants it."""
        return self._items[index] if 0 <= index < len(self._items) else None

    def takeAt(self, index: int) -> QLayoutItem | None:
        """Give up an item."""
        return self._items.pop(index) if 0 <= index < len(self._items) else None

    def hasHeightForWidth(self) -> bool:
        """A narrow bar has more rows."""
        return True

    def heightForWidth(self, width: int) -> int:
        """Height that all rows need, screen pixels."""
        return self._place(QRect(0, 0, width, 0), move=False)

    def sizeHint(self) -> QSize:
        """All in one row."""
        hints = [item.sizeHint() for item in self._shown()]
        width = sum(hint.width() + self.spacing() for hint in hints)
        return self._around(QSize(width, max((hint.height() for hint in hints), default=0)))

    def minimumSize(self) -> QSize:
        """Each control in a row of its own; the height of one row, as the view yields first."""
        least = QSize()
        for item in self._shown():
            least = least.expandedTo(item.minimumSize())
        return self._around(least)

    def setGeometry(self, area: QRect) -> None:
        """Place everything."""
        super().setGeometry(area)
        self._place(area, move=True)

    def _shown(self) -> list[QLayoutItem]:
        return [item for item in self._items if not item.isEmpty()]

    def _around(self, size: QSize) -> QSize:
        margins = self.contentsMargins()
        return size.grownBy(margins)

    def _place(self, area: QRect, *, move: bool) -> int:
        """Height that is needed in an area of that width; with `move`, put everything there."""
        inner, gap = area.marginsRemoved(self.contentsMargins()), self.spacing()
        top = inner.top()
        for row in self._rows(inner.width()):
            heights = [_height(item, width) for item, width in row]
            left, high = inner.left(), max(heights)
            for (item, width), height in zip(row, heights, strict=True):
                if move:
                    item.setGeometry(QRect(left, top + (high - height) // 2, width, height))
                left += width + gap
            top += high + gap
        return top - gap - area.top() + self.contentsMargins().bottom()

    def _rows(self, room: int) -> list[list[tuple[QLayoutItem, int]]]:
        """Items of each row, with their widths."""
        shown, gap = self._shown(), self.spacing()
        if not shown:
            return []
        text, controls = shown[0], shown[1:]
        rest = room - sum(item.sizeHint().width() + gap for item in controls)
        if rest >= min(text.sizeHint().width(), LEAST_TEXT):
            return [[(text, rest), *((item, item.sizeHint().width()) for item in controls)]]
        rows, left = list[list[QLayoutItem]](), 0
        for item in controls:
            if not rows or left < item.minimumSize().width():
                rows.append([])
                left = room
            rows[-1].append(item)
            left -= item.minimumSize().width() + gap
        return [[(text, room)], *(_widths(row, room - gap * (len(row) - 1)) for row in rows)]


def _widths(row: list[QLayoutItem], room: int) -> list[tuple[QLayoutItem, int]]:
    """Items with their widths: the least, and what is left goes to the first that wants more."""
    left, sized = room - sum(item.minimumSize().width() for item in row), []
    for item in row:
        least = item.minimumSize().width()
        more = max(min(item.sizeHint().width() - least, left), 0)
        left -= more
        sized.append((item, least + more))
    return sized


def _height(item: QLayoutItem, width: int) -> int:
    return item.heightForWidth(width) if item.hasHeightForWidth() else item.sizeHint().height()


class Elided(QLabel):
    """A label that leaves out some of what does not fit; its tool tip may have all.

    `where`: What is left out.
    `least`: A text that is always whole.
    """

    def __init__(self, where: Qt.TextElideMode, least: str = "") -> None:
        super().__init__()
        self._where, self._least = where, least

    def minimumSizeHint(self) -> QSize:
        """As wide as the text that is always whole."""
        least = self.fontMetrics().horizontalAdvance(self._least)
        return QSize(least, super().minimumSizeHint().height())

    def paintEvent(self, _: QPaintEvent) -> None:
        """Write what fits."""
        text = self.fontMetrics().elidedText(self.text(), self._where, self.width())
        QPainter(self).drawText(self.rect(), Qt.AlignmentFlag.AlignVCenter, text)
