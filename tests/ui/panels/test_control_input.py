"""The wheel scrolls panels; it changes a setting only where the operator put the focus."""

from PySide6.QtWidgets import QAbstractSpinBox, QComboBox, QScrollArea, QSlider
from window_driver import turn_wheel


def value(widget):
    return widget.currentIndex() if isinstance(widget, QComboBox) else widget.value()


def in_sight(panel):
    found = [w for kind in (QAbstractSpinBox, QSlider, QComboBox) for w in panel.findChildren(kind)]
    seen = lambda w: w.visibleRegion().contains(w.rect().center())  # noqa: E731
    return [widget for widget in found if widget.isEnabled() and seen(widget)]


def test_wheel_over_a_control_scrolls_the_panel_without_changing_it(drive):
    driver = drive(frame=5)
    driver.state.change(kappa=3.0, layers=driver.state.settings.layers | {"cloud"})
    for name in ("layers", "kappa", "pose", "compare"):
        dock = driver.window.panels[name]
        dock.show()
        dock.raise_()
        driver.wait_until_shown()
        driver.activate()
        controls = in_sight(dock)
        assert controls
        for notches in (-1, 1):  # one of them would move what is at its end
            for widget in controls:
                before, chosen = value(widget), driver.state.settings
                turn_wheel(widget, notches)
                assert (value(widget), driver.state.settings) == (before, chosen), widget.toolTip()
                assert not widget.hasFocus()
    driver.window.resize(1024, 500)
    driver.wait_until_shown()
    (area,) = dock.findChildren(QScrollArea)
    bar = area.verticalScrollBar()
    driver.wait(lambda: bar.maximum() > 0)
    bar.setValue(0)
    turn_wheel(in_sight(dock)[0], -1)
    assert bar.value() > 0
    # it changes the number with the focus
    driver.window.panels["kappa"].raise_()
    box = driver.window.kappa.box
    driver.window.kappa.automatic.setChecked(False)
    driver.wait_until_shown()
    before = driver.state.settings.kappa
    driver.activate()
    box.setFocus()
    assert box.hasFocus()
    turn_wheel(box, 1)
    assert driver.state.settings.kappa > before
