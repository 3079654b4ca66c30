"""Every control says what it is."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSlider,
    QAbstractSpinBox,
    QComboBox,
    QScrollBar,
    QWidget,
)
from window_driver import Driver

from bubbleviz_ui.panels.status_bar import TIPS

Drive = Callable[..., Driver]
CONTROLS = (QAbstractButton, QAbstractSlider, QAbstractSpinBox, QComboBox)


def test_every_control_has_a_tooltip(drive: Drive) -> None:
    driver = drive(frame=3)
    silent = []
    for name, panel in driver.window.panels.items():
        for widget in panel.findChildren(QWidget):
            own = not widget.objectName().startswith("qt_") and not isinstance(widget, QScrollBar)
            if isinstance(widget, CONTROLS) and own and not widget.toolTip():
                text = widget.text() if isinstance(widget, QAbstractButton) else ""
                silent.append((name, type(widget).__name__, text))
    assert not silent


def test_numbers_name_their_equation() -> None:
    for name in ("force", "area", "gas", "residual"):
        assert "Eq." in TIPS[name] or "V-C" in TIPS[name]
