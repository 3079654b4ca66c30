"""Docks that become tabs of others when they are opened, and panels that scroll when short."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QDockWidget,
    QFrame,
    QMainWindow,
    QScrollArea,
    QStyle,
    QWidget,
)


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

        Parameters
        ----------
        neighbour : QDockWidget
        narrower_than : int, optional
            Only in a window that is less wide, screen pixels.
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
            window.resizeDocks([self], [window.height()], Qt.Orientation.Vertical)


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
