"""Every control says what it is."""

from __future__ import annotations

import re
from collections.abc import Callable

from PySide6.QtGui import QAction
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSlider,
    QAbstractSpinBox,
    QComboBox,
    QLabel,
    QScrollBar,
    QWidget,
)
from window_driver import Driver

from bubbleviz_ui.model.costs import STAGES
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


def said(window: QWidget) -> set[str]:
    """Every label, button, menu item and tooltip of a window."""
    shown = [*window.findChildren(QLabel), *window.findChildren(QAbstractButton)]
    texts = {each.text() for each in [*shown, *window.findChildren(QAction)]}
    return texts | {widget.toolTip() for widget in window.findChildren(QWidget)}


def test_labels_say_what_they_mean(drive: Drive) -> None:
    driver = drive(frame=3)
    texts = said(driver.window) | set(STAGES.values())
    assert texts >= {
        "Colour points by", "Maximum pressure", "Maximum residual ±", "Rotate", "Probe",
        "Turntable", "Remove", "Remove parts below", "Pressure prior", "Ray-cast passes",
        "Pixel binning", "Gas pressure change p_v",
    }  # fmt: skip
    assert driver.window.status.labels["gas"].text().startswith("p_v ")
    bare = re.compile(r"(?<!section )\b(V-C|VI)\b|^\W*Eq\.")
    assert not [text for text in texts if bare.search(text)]
