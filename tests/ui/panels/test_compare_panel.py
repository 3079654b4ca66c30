"""Two settings side by side, in numbers and outlines, and one of them used in the whole window."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from fakes import DentSource, small_sensor
from live_bench import Bench, sensor_file
from PySide6.QtCore import QPoint, Qt
from window_driver import Driver, texts

from bubbleviz.calibration.pressure_zero import ENOUGH
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.result import Result
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.model.choices import Setting
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_maps import rgb

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton
CONTACT = 75


def number(text: str) -> float:
    return float(text.split()[0])


def outlines(driver: Driver) -> list[int]:
    """How many pixels of the 3-D view have the colour of A's outline, and of B's."""
    pixels = driver.window.view.pixels()
    return [int(np.all(pixels == rgb(c), axis=2).sum()) for c in theme.COMPARED]


def text(driver: Driver, row: str) -> str:
    return driver.window.compare.a.values[row].text()


def wait_until_as_shown(driver: Driver) -> None:
    """Wait until A, the window's own setting, is measured to be what the window shows."""

    def as_shown() -> bool:
        result, units = driver.window.controller.result, driver.state.units
        assert result is not None and result.patch is not None
        force = units.force.text(float(np.linalg.norm(result.patch.force_n)))
        shown = (f"{result.frame.index}", force, units.area.text(result.patch.area_m2))
        compared = tuple(text(driver, row) for row in ("frame", "force", "area"))
        return driver.window.controller.settled and compared == shown

    driver.wait(as_shown)


def test_both_outlines_are_in_the_picture_of_their_frame_alone(drive: Drive) -> None:
    driver = drive(DentSource, frame=8)
    window, panel, controller = driver.window, driver.window.compare, driver.window.controller
    a, b = Setting(solver="linear", kappa=1.0), Setting(solver="linear", kappa=4.0, nodes=300)
    driver.state.choose(layers=frozenset({"membrane", "compared"}), compared=(a, b))
    driver.settle()
    assert outlines(driver) == [0, 0]
    window.panels["compare"].show()
    driver.wait(lambda: min(outlines(driver)) > 20)
    assert outlines(driver)[0] > 1.1 * outlines(driver)[1]  # A's patch is the larger one
    driver.bot.mouseClick(panel.outlines, LEFT, pos=QPoint(10, 10))
    assert outlines(driver) == [0, 0]
    driver.bot.mouseClick(panel.outlines, LEFT, pos=QPoint(10, 10))
    assert min(outlines(driver)) > 20
    driver.state.seek(9)
    assert outlines(driver) == [0, 0]
    driver.wait(lambda: text(driver, "frame") == "9")
    assert min(outlines(driver)) > 20
    stale: list[bool] = []

    def look(result: Result) -> None:
        if text(driver, "frame") not in ("–", f"{result.frame.index}"):
            stale.append(outlines(driver) != [0, 0])

    shown = controller.shown.connect(look)
    driver.state.set_playing(True)
    driver.wait(lambda: len(stale) > 3)
    driver.state.set_playing(False)
    controller.shown.disconnect(shown)
    assert not any(stale)
    driver.seek(9)
    driver.settle()
    driver.state.choose(compared=(a, Setting(solver="no such")))
    assert outlines(driver) == [0, 0]
    driver.wait(lambda: panel.b.values["status"].text() == "impossible")
    assert outlines(driver)[0] > 20 and outlines(driver)[1] == 0
    driver.state.seek(0)
    driver.wait(lambda: text(driver, "status") == "no_contact")
    assert outlines(driver) == [0, 0]
    driver.seek(9)
    driver.wait(lambda: outlines(driver)[0] > 20)
    window.panels["compare"].hide()
    assert outlines(driver) == [0, 0]


def test_the_window_s_own_setting_measures_what_the_window_shows(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    driver.window.panels["compare"].show()
    driver.state.choose(compared=(Setting(), Setting(solver="linear", nodes=100)))
    wait_until_as_shown(driver)
    for frame in (CONTACT - 15, CONTACT):  # from elsewhere, with another warm start
        driver.seek(frame)
        wait_until_as_shown(driver)
    driver.state.choose(least_area_m2=1.0)
    driver.wait(lambda: driver.window.controller.result.patch.area_m2 == 0.0)
    driver.wait(lambda: text(driver, "area").startswith("0 "))


def test_numbers_say_which_frame_they_are_of(drive: Drive) -> None:
    driver = drive(frame=CONTACT)
    driver.window.panels["compare"].show()
    driver.wait(lambda: text(driver, "frame") == f"{CONTACT}")
    driver.state.seek(2)
    assert {text(driver, row) for row in ("frame", "status", "force")} == {"–"}
    named: list[tuple[str, int]] = []
    compared = driver.window.controller.compared
    naming = compared.connect(lambda new: named.append((text(driver, "frame"), new.request.index)))
    driver.state.set_playing(True)
    driver.wait(lambda: len(named) > 5)
    driver.state.set_playing(False)
    driver.settle()
    driver.wait(lambda: text(driver, "frame") == f"{driver.state.frame}")
    compared.disconnect(naming)
    assert all(text == f"{index}" for text, index in named)


def test_a_live_frame_is_compared_with_its_gas_pressure_zeroed(
    open_bench: Callable[[], Bench],
) -> None:
    live = open_bench()
    live.connect(single("synthetic:?frames=6", sensor_file(live.folder)))
    zero = live.run.session.sensors[0].zero
    zero.zero_now()
    for _ in range(ENOUGH):
        zero.learn(zero.reference_pa + 250.0, contact_free=True)
    live.window.panels["compare"].show()
    live.follow()
    live.wait(lambda: live.window.controller.result.patch.area_m2 > 0.0)
    live.state.freeze(True)
    live.settle()
    wait_until_as_shown(live)


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


def test_friction_is_a_setting_whose_tangential_force_is_shown_everywhere(drive: Drive) -> None:
    sensor = small_sensor()
    known = sensor.membrane.model_copy(update={"prestretch": 1.3})
    exact = sensor.model_copy(update={"membrane": known})
    driver = drive(DentSource, sensor=exact, frame=6)
    window, panel = driver.window, driver.window.compare
    window.panels["compare"].show()

    def tangential() -> str:
        """As the whole window shows it."""
        (said,) = [text for text in texts(driver) if "tangential" in text]
        shown = said.split("tangential ")[1].split("   ")[0]
        assert window.status.labels["force"].toolTip().endswith(f"by depth alone: {shown}")
        return shown

    estimate = window.controller.result.estimate
    whole, normal = estimate.force_n, estimate.force_n - estimate.friction_n.sum(axis=0)
    friction = np.linalg.norm(whole - normal)
    assert friction > 0.05 and tangential() == f"{friction:.2f} N"
    driver.wait(lambda: text(driver, "tangential") == f"{friction:.2f} N")
    driver.state.choose(force_unit="mN")
    driver.settle()
    assert tangential() == f"{1e3 * friction:.0f} mN" == text(driver, "tangential")
    driver.state.choose(force_unit="N")
    driver.settle()
    assert panel.b.values["tangential"].text() == "– N"  # the linear model has none

    panel.a.friction.setFocus()
    panel.a.friction.selectAll()
    driver.bot.keyClicks(panel.a.friction, "0")
    driver.bot.keyClick(panel.a.friction, Qt.Key.Key_Return)
    assert panel.a.friction.text() == "none"
    driver.wait(lambda: text(driver, "tangential") == "– N")
    driver.bot.mouseClick(panel.a.used, LEFT)
    driver.wait(lambda: driver.pipeline.options.friction == 0.0)
    driver.settle()
    estimate = window.controller.result.estimate
    assert not estimate.friction_n.any() and np.linalg.norm(estimate.force_n) > 0.1
    assert tangential() == "– N"
    for _ in range(2):
        window.undo_stack.undo()
    driver.wait(lambda: driver.pipeline.options.friction == EstimatorOptions().friction)
    driver.settle()
    driver.wait(lambda: tangential() == f"{friction:.2f} N")
    driver.seek(0)
    assert window.status.labels["force"].toolTip().endswith("by depth alone: 0.00 N")


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
    panel.b.kappa.setFocus()
    panel.b.kappa.selectAll()
    driver.bot.keyClicks(panel.b.kappa, "4.5")
    driver.bot.keyClick(panel.b.kappa, Qt.Key.Key_Return)
    driver.wait(driver.thresholded)
    assert driver.state.choices.kappa == window.kappa.box.value() == 4.5
    panel.a.kappa.setValue(7.0)
    assert driver.state.choices.kappa == 4.5
    for _ in range(2):
        window.undo_stack.undo()
    assert driver.state.choices.kappa == panel.b.kappa.value() == 2.5
    for _ in range(3):
        window.undo_stack.undo()
    driver.wait(lambda: driver.pipeline.options.solver is None)
    driver.settle()
    assert driver.state.choices.kappa is None and driver.state.choices.solver is None
