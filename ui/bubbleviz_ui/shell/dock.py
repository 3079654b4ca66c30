"""Docks and layout helpers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from PySide6.QtCore import QEvent, QRect, QSize, Qt, SignalInstance
from PySide6.QtGui import QCloseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import (
    QAbstractButton,
    QBoxLayout,
    QDockWidget,
    QFrame,
    QHBoxLayout,
    QLabel,
    QLayout,
    QMainWindow,
    QPushButton,
    QScrollArea,
    QStyle,
    QToolButton,
    QWidget,
)

USABLE = 0.6
"""Below this share of its size hint a dock that is opened becomes a tab."""


class Dock(QDockWidget):
    """Dock of a panel, of a height that is kept, or as a tab of another dock.

    It is placed as a tab when it is first shown: Qt would draw tabs of docks that were never shown.

    `home`: The dock of which it is a tab.
    `narrower_than`: Only if the window is narrower than this, screen pixels.
    `sized`: Has the height of the panel's size hint, more or less what the operator dragged. A tab
    takes the height that other docks of its side do not need.
    """

    placed = False  # Not opened yet
    restoring = False  # While Qt restores the layout: to change it then crashes Qt
    opened_s = 0.0  # When it was opened last, by a monotonic clock

    def __init__(
        self,
        title: str,
        window: QMainWindow,
        home: Dock | None = None,
        narrower_than: float = math.inf,
        *,
        sized: bool = False,
    ) -> None:
        super().__init__(title, window)
        self.home, self._narrower_than = home or self, narrower_than
        self._sized, self._maximises = sized, home is not None and not sized
        self._opened, self._hint = False, 0
        self.above_hint = 0  # What the operator dragged, screen pixels

    def setVisible(self, visible: bool) -> None:
        """Show or hide; open in front of its tabs."""
        window, opened = self.parentWidget(), visible and self.isHidden()
        if self.restoring or not (opened and isinstance(window, QMainWindow)):
            self.placed |= self.restoring and visible
            super().setVisible(visible)
            return
        narrow = window.width() < self._narrower_than
        if self.home is not self and narrow and not self.placed:
            window.tabifyDockWidget(self.home, self)
        self._opened = self.placed = True
        self.opened_s = time.monotonic()
        super().setVisible(visible)
        self.raise_()
        self.restore_height()
        if self._maximises:
            own = [self, *window.tabifiedDockWidgets(self)]
            others = [d for d in column(window, window.dockWidgetArea(self)) if d not in own]
            heights = [window.height(), *(1 for _ in others)]
            window.resizeDocks([self, *others], heights, Qt.Orientation.Vertical)

    def closeEvent(self, event: QCloseEvent) -> None:
        """Come to the front if it is behind a tab: whoever chose its menu entry looks for it."""
        if self.isFloating() or self._in_front:
            super().closeEvent(event)
            return
        event.ignore()
        self.raise_()
        self.toggleViewAction().setChecked(True)

    @property
    def needed(self) -> int:
        """Least height in which it is usable, screen pixels."""
        usable = USABLE * self.sizeHint().height() if self._sized or self._maximises else 0.0
        return max(math.ceil(usable), self.minimumSizeHint().height())

    @property
    def too_low(self) -> bool:
        """Whether it was opened in the window since this was asked last, with too little height."""
        opened, self._opened = self._opened and self._in_front, False
        return opened and not self.isFloating() and self.height() < self.needed

    def event(self, event: QEvent) -> bool:
        """Follow the size hint of the panel."""
        done = super().event(event)
        if event.type() == QEvent.Type.LayoutRequest and self.sizeHint().height() != self._hint:
            self.restore_height()
        return done

    @property
    def _in_front(self) -> bool:
        return not self.visibleRegion().isEmpty()

    def keep_height(self) -> None:
        """Keep the present height, which the operator chose."""
        if self._sized and self._in_front:
            self.above_hint = self.height() - self.sizeHint().height()

    def restore_height(self) -> None:
        """Take the height to be kept unless hidden, by a tab too."""
        if self._in_front:
            self.take_height()

    def take_height(self) -> None:
        """Take the height to be kept, if the window has room for it."""
        window, self._hint = self.parentWidget(), self.sizeHint().height()
        if self._sized and isinstance(window, QMainWindow):
            height = self._hint + self.above_hint
            window.resizeDocks([self], [height], Qt.Orientation.Vertical)


def column(window: QMainWindow, side: Qt.DockWidgetArea) -> list[Dock]:
    """The docks shown at a side of the window, also behind tabs."""
    direct = Qt.FindChildOption.FindDirectChildrenOnly  # not through thousands of widgets
    docks = window.findChildren(Dock, options=direct)
    at_side = [dock for dock in docks if window.dockWidgetArea(dock) == side]
    return [dock for dock in at_side if not (dock.isHidden() or dock.isFloating())]


def in_front(docks: Sequence[Dock]) -> Dock:
    """The first of some docks that is not behind a tab, where it keeps its former size."""
    return next((dock for dock in docks if not dock.visibleRegion().isEmpty()), docks[0])


class TabsForRoom:
    """Makes tabs of all docks of a side of the window; they come apart when there is room again."""

    def __init__(self, window: QMainWindow, docks: Sequence[Dock]) -> None:
        self._window, self._docks = window, docks
        self.made = set[Qt.DockWidgetArea]()  # Sides that have them now

    def make(self, front: Dock) -> None:
        """Make tabs of all docks at the side of the front one."""
        side = self._window.dockWidgetArea(front)
        first, *others = column(self._window, side)
        for dock in others:
            self._window.tabifyDockWidget(first, dock)
        for dock in self._at(side):
            dock.placed = not dock.isHidden()
        front.raise_()
        front.take_height()
        self.made.add(side)

    def part(self, side: Qt.DockWidgetArea, more: int) -> None:
        """Place docks that `make` placed as in a new window, if there is room.

        `more`: Height that the 3-D view can give, screen pixels.
        """
        shown = column(self._window, side)
        if side not in self.made or not shown:
            return
        if len(self._window.tabifiedDockWidgets(shown[0])) + 1 < len(shown):
            self.made.remove(side)  # arranged by the operator
            return
        needed = dict[Dock, int]()
        for dock in shown:
            needed[dock.home] = max(needed.get(dock.home, 0), dock.needed)
        front = in_front(shown)
        if len(needed) > 1 and sum(needed.values()) <= front.height() + more:
            self.made.remove(side)
            for dock in self._at(side):
                if dock.home is dock:
                    self._window.addDockWidget(side, dock, Qt.Orientation.Vertical)
                elif dock.isHidden():
                    dock.placed = False
                else:
                    self._window.tabifyDockWidget(dock.home, dock)
            front.raise_()
            for dock in shown:
                dock.restore_height()

    def _at(self, side: Qt.DockWidgetArea) -> list[Dock]:
        """Docks at a side, also hidden ones, those that others are tabs of first."""
        docks = [dock for dock in self._docks if not dock.isFloating()]
        at_side = [dock for dock in docks if self._window.dockWidgetArea(dock) == side]
        return sorted(at_side, key=lambda dock: dock.home is not dock)


def scrolled(panel: QWidget) -> QScrollArea:
    """The panel in a vertical scroll area, so that it does not enlarge the window."""
    area = QScrollArea()
    area.setWidget(panel)
    area.setWidgetResizable(True)
    area.setFrameShape(QFrame.Shape.NoFrame)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    bar = area.style().pixelMetric(QStyle.PixelMetric.PM_ScrollBarExtent)
    area.setMinimumWidth(panel.minimumSizeHint().width() + bar)
    return area


# Layout helpers, and bars and labels for narrow windows.

MIN_TEXT = 240
"""Smallest width of a long text next to controls, screen pixels."""

FRAME = QSize(8, 40)
"""Largest frame of a window manager, screen pixels."""

Item = QWidget | QLayout | int
A = TypeVar("A", bound=QAbstractButton)
B = TypeVar("B", bound=QBoxLayout)


def fill(
    layout: B,
    *items: Item | tuple[Item, int],
    margins: tuple[int, int, int, int] | None = None,  # Left, top, right and bottom, screen pixels
    spacing: int | None = None,  # Between the items, screen pixels
) -> B:
    """Add items to a row or column.

    `items`: Widgets or layouts, each optionally in a tuple with its stretch; a number alone is a
    stretch.
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


def resize_on_screen(window: QWidget, width: int, height: int) -> None:
    """Resize a window or dialog to these screen pixels, or less if its screen has no room."""
    window.resize(QSize(width, height).boundedTo(window.screen().availableSize() - FRAME))


class BarLayout(QBoxLayout):
    """A text beside controls, or above them if narrow."""

    def __init__(
        self,
        parent: QWidget,
        text: QWidget,
        *controls: QWidget,
        margins: tuple[int, int, int, int],  # Left, top, right and bottom, screen pixels
    ) -> None:
        super().__init__(QBoxLayout.Direction.LeftToRight, parent)
        self._text, self._controls = text, fill(QHBoxLayout(), *controls, spacing=6)
        fill(self, (text, 1), self._controls, margins=margins, spacing=6)

    def minimumSize(self) -> QSize:
        """Width of the wider part, and height at the present width."""
        least = self._text.minimumSizeHint().expandedTo(self._controls.minimumSize())
        width = least.grownBy(self.contentsMargins()).width()
        return QSize(width, self.minimumHeightForWidth(max(self.geometry().width(), width)))

    def setGeometry(self, area: QRect) -> None:
        beside = area.width() - self._controls.sizeHint().width()
        direction = QBoxLayout.Direction.LeftToRight
        if beside < min(self._text.sizeHint().width(), MIN_TEXT):
            direction = QBoxLayout.Direction.TopToBottom
        if direction != self.direction():
            self.setDirection(direction)
        super().setGeometry(area)


Do = Callable[..., object] | SignalInstance
"""What a click on a button does: calls a function, of a checkable one with its state, or emits."""


def push_button(text: str, tip: str = "", do: Do | None = None) -> QPushButton:
    """Push button with its tool tip and what it does."""
    return _set_up(QPushButton(text), tip, do)


def tool_button(
    text: str, tip: str, do: Do | None = None, *, checkable: bool = False
) -> QToolButton:
    """Tool button with its tool tip and what it does."""
    button = QToolButton()
    button.setText(text)
    button.setCheckable(checkable)
    return _set_up(button, tip, do)


def _set_up(button: A, tip: str, do: Do | None) -> A:
    button.setToolTip(tip)
    if do is not None:
        button.clicked.connect(do)
    return button


class Steady(QLabel):
    """Label of a fixed size, so that a new text in each frame does not lay the window out again.

    A text that needs more room still gets it.
    """

    def setText(self, text: str) -> None:
        super().setText(text)
        if self.sizeHint().width() > self.minimumWidth():
            self.fix_width(self.sizeHint().width())

    def fix_width(self, width: int) -> None:
        """Have this width until a text needs more, screen pixels."""
        self.setFixedSize(width, self.sizeHint().height())


class Elided(QLabel):
    """A label that elides its text.

    `where`: Position of the ellipsis.
    """

    def __init__(self, where: Qt.TextElideMode) -> None:
        super().__init__()
        self._where = where

    def minimumSizeHint(self) -> QSize:
        """Height of a line, in any width."""
        return QSize(0, super().minimumSizeHint().height())

    def paintEvent(self, _: QPaintEvent) -> None:
        """Draw the elided text."""
        text = self.fontMetrics().elidedText(self.text(), self._where, self.width())
        QPainter(self).drawText(self.rect(), Qt.AlignmentFlag.AlignVCenter, text)
