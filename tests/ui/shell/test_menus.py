"""Menus: check marks follow what they turn on and off; Close closes what is open."""

from __future__ import annotations

from collections.abc import Callable

from fakes import DentSource
from live_bench import Bench, contents, sensor_file
from PySide6.QtCore import Qt
from window_driver import Driver, texts

from bubbleviz.sensor import Sensor
from bubbleviz_ui.live.connection import single

Drive = Callable[..., Driver]
LEFT, CTRL = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.ControlModifier


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


def close(driver: Driver) -> None:
    """Press Ctrl+W and wait until the sensor is alone."""
    with driver.bot.waitActive(driver.window):
        driver.window.activateWindow()
    driver.bot.keyClick(driver.window, Qt.Key.Key_W, CTRL)
    assert driver.window.busy.label.text() == "Closing …"
    driver.wait(lambda: driver.window.windowTitle().startswith("nothing open – "))
    driver.settle()


def test_a_recording_is_closed_by_its_key_and_the_sensor_stays_at_rest(
    drive: Drive, sensor: Sensor
) -> None:
    source = DentSource(sensor)
    driver = drive(lambda _: source, frame=11)
    assert len(driver.warm_pixels()) > 100 and not source.closed
    close(driver)
    assert source.closed and driver.pipeline.model.sensor == sensor
    assert not len(driver.warm_pixels()) and driver.state.facts.frames == 1
    assert driver.window.status.labels["force"].text() == "force – N"  # and not 0.00 N
    assert driver.window.status.labels["frame"].text() == "frame – · – s"
    assert driver.window.playback.readout.text().split() == ["frame", "–", "–", "s"]
    assert {"no contact", "no depth data"}.isdisjoint(texts(driver))
    for panel in driver.window.panels.values():
        panel.show()
    driver.state.choose(kappa=2.0, layers=frozenset(driver.window.layers.boxes))
    driver.settle()
    assert not driver.window.message.isVisible()
    driver.bot.keyClick(driver.window, Qt.Key.Key_Space)
    driver.bot.keyClick(driver.window, Qt.Key.Key_End)
    close(driver)
    again = lambda made: DentSource(made)  # noqa: E731
    driver.window.controller.opening.open("dent", again, lambda: sensor, frame=11, playing=False)
    driver.wait(lambda: driver.state.facts.title == "dent")
    driver.settle()
    assert len(driver.warm_pixels()) > 100


def test_a_live_source_is_closed_and_what_was_being_recorded_is_whole(
    open_bench: Callable[[], Bench],
) -> None:
    live = open_bench()
    live.connect(single("synthetic:?frames=6", sensor_file(live.folder)))
    live.record()
    path = live.status().path
    close(live)
    live.wait(lambda: "Recorded" in live.window.notice.label.text())
    assert contents(path) and live.live_controller.run is None
    assert not live.state.playing
