"""Undo and redo of the window's settings, by the keys a person would press."""

from __future__ import annotations

from collections.abc import Callable

from conftest import Driver
from PySide6.QtCore import QPoint, Qt
from PySide6.QtWidgets import QStyle, QStyleOptionSlider, QWidget

from ui.presets import load_scene
from ui.state import Choices

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton
CTRL, SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier


def undo(driver: Driver, widget: QWidget | None = None) -> None:
    with driver.bot.waitActive(driver.window):
        driver.window.activateWindow()
    driver.bot.keyClick(widget or driver.window, Qt.Key.Key_Z, CTRL)


def redo(driver: Driver) -> None:
    driver.bot.keyClick(driver.window, Qt.Key.Key_Z, CTRL | SHIFT)


CHANGES = {
    "layers": frozenset({"rim"}),
    "kappa": 3.0,
    "solver": "fast",
    "speed": 2.0,
    "every_frame": True,
    "loop": False,
    "plots": frozenset({"area"}),
    "cloud_colour": "patch",
    "cloud_points": 5000,
    "membrane_opacity": 0.4,
    "pressure_max_pa": 3000.0,
    "residual_max_m": 2e-3,
    "theme": "light",
}


def test_every_choice_is_undone_and_done_again(drive: Drive) -> None:
    driver = drive(frame=3)
    seen = [driver.state.choices]
    for name, value in CHANGES.items():
        driver.state.choose(**{name: value})
        seen.append(driver.state.choices)
    assert driver.window.undo_stack.index() == len(CHANGES)
    for before in reversed(seen[:-1]):
        undo(driver)
        assert driver.state.choices == before
    for after in seen[1:]:
        redo(driver)
        assert driver.state.choices == after
    driver.state.choose(theme="system")
    driver.settle()


def test_clicks_are_steps_and_the_panel_follows(drive: Drive) -> None:
    driver = drive(frame=3)
    layers = driver.window.layers
    for name in ("wireframe", "rim"):
        driver.bot.mouseClick(layers.boxes[name], LEFT, pos=QPoint(10, 8))
    assert layers.boxes["wireframe"].isChecked() and not layers.boxes["rim"].isChecked()
    undo(driver)
    assert layers.boxes["rim"].isChecked() and layers.boxes["wireframe"].isChecked()
    undo(driver)
    assert not layers.boxes["wireframe"].isChecked()
    assert driver.state.choices.layers == Choices().layers


def test_a_dragged_slider_is_one_step(drive: Drive) -> None:
    driver = drive(frame=3)
    slider = driver.window.layers.opacity
    option = QStyleOptionSlider()
    slider.initStyleOption(option)
    control, part = QStyle.ComplexControl.CC_Slider, QStyle.SubControl.SC_SliderHandle
    place = slider.style().subControlRect(control, option, part, slider).center()
    driver.bot.mousePress(slider, LEFT, pos=place)
    for step in range(1, 8):
        driver.bot.mouseMove(slider, place - QPoint(8 * step, 0))
    driver.bot.mouseRelease(slider, LEFT, pos=place - QPoint(56, 0))
    assert driver.state.choices.membrane_opacity < 0.8
    assert driver.window.undo_stack.index() == 1
    undo(driver)
    assert driver.state.choices.membrane_opacity == 1.0 and slider.value() == 100


def test_a_scene_is_one_step(drive: Drive) -> None:
    driver = drive(frame=3)
    driver.window.use_scene(load_scene("residual"))
    assert driver.state.choices.layers != Choices().layers
    assert driver.window.undo_stack.index() == 1
    undo(driver)
    assert driver.state.choices.layers == Choices().layers
    assert driver.state.choices.view_from == Choices().view_from


def test_range_and_markers(drive: Drive) -> None:
    driver = drive(frame=3)
    driver.state.toggle_marker(3)
    driver.state.choose_range((2, 9))
    undo(driver)
    assert driver.state.play_range is None and driver.state.markers == (3,)
    undo(driver)
    assert driver.state.markers == ()
    redo(driver)
    redo(driver)
    assert driver.state.play_range == (2, 9) and driver.state.markers == (3,)


def test_undo_goes_to_the_window_from_within_a_number_box(drive: Drive) -> None:
    driver = drive(frame=3)
    box = driver.window.kappa.box
    driver.window.kappa.automatic.setChecked(False)
    box.setFocus()
    box.selectAll()
    driver.bot.keyClicks(box, "2.5")
    driver.bot.keyClick(box, Qt.Key.Key_Return)
    assert driver.state.choices.kappa == 2.5
    undo(driver, box)
    assert driver.state.choices.kappa != 2.5
