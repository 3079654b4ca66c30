"""Layouts, filled in one statement."""

from __future__ import annotations

from typing import TypeVar

from PySide6.QtWidgets import QBoxLayout, QLayout, QWidget

Item = QWidget | QLayout | int
B = TypeVar("B", bound=QBoxLayout)


def fill(
    layout: B,
    *items: Item | tuple[Item, int],
    margins: tuple[int, int, int, int] | None = None,
    spacing: int | None = None,
) -> B:
    """Fill a row or a column.

    Parameters
    ----------
    layout : QBoxLayout
    items : widgets, layouts and int
        One after the other; with its stretch where it has one. A number alone is a stretch.
    margins : tuple of 4 int, optional
        Left, top, right and bottom, screen pixels.
    spacing : int, optional
        Between the items, screen pixels.
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
