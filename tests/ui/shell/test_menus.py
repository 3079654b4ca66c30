"""Check marks in the menus: each turns its thing on and off, and follows it however it changes."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import Qt
from window_driver import Driver

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton


def test_check_marks_follow_the_state(drive: Drive) -> None:
    driver = drive(frame=3)
    actions, state = driver.window.shortcuts.actions, driver.state
    for name, choice in (("Playback › Loop", "loop"), ("Playback › Every frame", "every_frame")):
        before = getattr(state.choices, choice)
        assert actions[name].isChecked() == before
        actions[name].trigger()
        assert getattr(state.choices, choice) is actions[name].isChecked() is not before
        driver.window.undo_stack.undo()
        assert actions[name].isChecked() == before
    mark = actions["Playback › Mark this frame"]
    mark.trigger()
    assert state.markers == (3,) and mark.isChecked()
    driver.seek(4)
    assert not mark.isChecked()
    full = actions["View › Full screen"]
    full.trigger()
    assert full.isChecked() and driver.window.isFullScreen()
    full.trigger()
    assert not full.isChecked()


def test_check_marks_of_the_tools_are_those_of_the_panel(drive: Drive) -> None:
    driver = drive(frame=3)
    actions, tools = driver.window.shortcuts.actions, driver.window.tools
    driver.bot.mouseClick(tools.turn, LEFT)
    turntable = actions["View › Turntable"]
    assert turntable.isChecked() and tools.turntable.turning
    turntable.trigger()
    assert not turntable.isChecked() and not tools.turntable.turning
    probe, distance = actions["View › Probe a place"], actions["View › Measure a distance"]
    probe.trigger()
    assert probe.isChecked() and tools.tools["probe"].isChecked() and tools.tool == "probe"
    driver.bot.mouseClick(tools.tools["distance"], LEFT)
    assert distance.isChecked() and not probe.isChecked()
    distance.trigger()
    assert not distance.isChecked() and tools.tool == "rotate"


def test_what_has_no_live_source_cannot_be_checked(drive: Drive) -> None:
    driver = drive(frame=3)
    for name in ("Playback › Freeze a live source", "Live › Record", "Live › Publish results"):
        action = driver.window.shortcuts.actions[name]
        assert action.isCheckable()
        action.trigger()
        assert not action.isChecked(), name
