"""Playback icons, drawn, so they have the window's colours on every desktop."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QIcon, QPainter, QPixmap, QPolygonF

from bubbleviz_ui.shell import theme

SIZE = 64
SHAPES: dict[str, tuple[tuple[str, float], ...]] = {
    "play": (("right", 0.5),),
    "pause": (("bar", 0.34), ("bar", 0.66)),
    "back": (("bar", 0.72), ("left", 0.42)),
    "forward": (("bar", 0.28), ("right", 0.58)),
    "first": (("bar", 0.16), ("left", 0.40), ("left", 0.74)),
    "last": (("right", 0.26), ("right", 0.60), ("bar", 0.84)),
}
"""Each icon as triangles and bars with their centres, from left to right."""


def icon(name: str, colours: theme.Colours) -> QIcon:
    """Icon of one playback action."""
    pixmap = QPixmap(SIZE, SIZE)
    pixmap.fill(Qt.GlobalColor.transparent)
    painter = QPainter(pixmap)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(QColor(colours.text))
    for shape, centre in SHAPES[name]:
        if shape == "bar":
            painter.drawRect(QRectF((centre - 0.06) * SIZE, 0.2 * SIZE, 0.12 * SIZE, 0.6 * SIZE))
        else:
            painter.drawPolygon(_triangle(centre, 1.0 if shape == "right" else -1.0, name))
    painter.end()
    return QIcon(pixmap)


def _triangle(centre: float, direction: float, name: str) -> QPolygonF:
    half = 0.30 if name == "play" else 0.17
    tip, base = centre + direction * half, centre - direction * half
    corners = ((base, 0.2), (tip, 0.5), (base, 0.8))
    return QPolygonF([QPointF(x * SIZE, y * SIZE) for x, y in corners])
