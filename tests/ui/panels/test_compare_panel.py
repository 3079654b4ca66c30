"""Two settings side by side, κ among them, and one of them used in the whole window."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from fakes import DentSource
from PySide6.QtCore import Qt
from window_driver import Driver

from bubbleviz_ui.model.choices import Setting

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton


def number(text: str) -> float:
    return float(text.split()[0])


def test_settings_that_differ_in_kappa_differ_in_area_alone(drive: Drive) -> None:
    driver = drive(DentSource, frame=8)
    driver.window.panels["compare"].show()
    panel = driver.window.compare
    driver.state.choose(compared=(Setting(solver="linear"), Setting(solver="linear")))
    panel.a.kappa.setValue(1.0)
    panel.b.kappa.setValue(4.0)
    area = lambda column: column.values["area"].text()  # noqa: E731
    driver.wait(lambda: area(panel.a) != area(panel.b) and area(panel.b)[0].isdigit())
    assert number(area(panel.a)) > 1.2 * number(area(panel.b))
    a, b = (number(column.values["residual"].text()) for column in (panel.a, panel.b))
    assert a == pytest.approx(b, rel=0.02)


def test_a_setting_is_used_everywhere_and_undone(drive: Drive) -> None:
    driver = drive(DentSource, frame=8)
    window, panel = driver.window, driver.window.compare
    window.panels["compare"].show()
    driver.state.choose(compared=(Setting(), Setting(solver="linear", nodes=300, kappa=2.5)))
    driver.bot.mouseClick(panel.b.used, LEFT)
    driver.wait(lambda: driver.pipeline.options.nodes == 300)
    driver.settle()
    assert driver.pipeline.options.solver == "linear" and driver.state.choices.kappa == 2.5
    assert window.kappa.solver.currentText() == "setting B of Compare"
    panel.b.block.setValue(2)  # of what is in use
    driver.wait(lambda: driver.pipeline.options.block == 2)
    session = driver.server.session.number
    panel.a.block.setValue(3)  # of what is not
    driver.settle()
    assert driver.server.session.number == session
    for _ in range(3):
        window.undo_stack.undo()
    driver.wait(lambda: driver.pipeline.options.solver is None)
    driver.settle()
    assert driver.state.choices.kappa is None and driver.state.choices.solver is None
