"""The wheel scrolls panels; it changes a setting only where the operator put the focus."""

from collections.abc import Callable

import pytest
from PySide6.QtCore import QPoint, QPointF
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QDoubleSpinBox,
    QScrollArea,
    QSlider,
    QSpinBox,
    QWidget,
)
from window_driver import Driver

Drive = Callable[..., Driver]
NOTCH = 120


def activate(driver: Driver) -> None:
    with driver.bot.waitActive(driver.window):
        driver.window.activateWindow()


def turn_wheel(widget: QWidget, notches: int) -> None:
    window = widget.window()
    place = QPointF(widget.mapTo(window, widget.rect().center()))
    QTest.wheelEvent(window.windowHandle(), place, QPoint(0, notches * NOTCH))
    QApplication.processEvents()


def value(widget: QWidget) -> float:
    if isinstance(widget, QComboBox):
        return widget.currentIndex()
    assert isinstance(widget, QSlider | QSpinBox | QDoubleSpinBox)
    return widget.value()


def in_sight(panel: QWidget) -> list[QWidget]:
    kinds = QAbstractSpinBox, QSlider, QComboBox
    found = [widget for kind in kinds for widget in panel.findChildren(kind)]
    return [
        widget
        for widget in found
        if widget.isEnabled() and widget.visibleRegion().contains(widget.rect().center())
    ]


@pytest.mark.parametrize("name", ["layers", "kappa", "compare", "pose"])
def test_the_wheel_over_a_control_changes_nothing(drive: Drive, name: str) -> None:
    driver = drive(frame=75)
    dock = driver.window.panels[name]
    dock.show()
    dock.raise_()
    driver.settle()
    activate(driver)
    controls = in_sight(dock)
    assert controls
    for notches in (-1, 1):  # one of them would move what is at its end
        for widget in controls:
            before, chosen = value(widget), driver.state.choices
            turn_wheel(widget, notches)
            assert (value(widget), driver.state.choices) == (before, chosen), widget.toolTip()
            assert not widget.hasFocus()


def test_the_wheel_over_a_control_scrolls_its_panel(drive: Drive) -> None:
    driver = drive(frame=75)
    driver.window.resize(1024, 500)
    dock = driver.window.panels["compare"]
    dock.show()
    dock.raise_()
    driver.settle()
    (area,) = dock.findChildren(QScrollArea)
    bar = area.verticalScrollBar()
    driver.wait(lambda: bar.maximum() > 0)
    turn_wheel(in_sight(dock)[0], -1)
    assert bar.value() > 0


def test_the_wheel_changes_the_number_with_the_focus(drive: Drive) -> None:
    driver = drive(frame=75)
    box = driver.window.kappa.box
    driver.window.kappa.automatic.setChecked(False)
    driver.settle()
    before = driver.state.choices.kappa
    turn_wheel(box, 1)
    assert driver.state.choices.kappa == before
    activate(driver)
    box.setFocus()
    assert box.hasFocus()
    turn_wheel(box, 1)
    assert driver.state.choices.kappa > before
