"""Menus: check marks follow what they turn on and off; Close closes what is open."""

from fakes import DentSource
from live_bench import contents, sensor_file
from PySide6.QtCore import Qt
from window_driver import CTRL, texts

from bubbleviz_ui.live.connection import single


def close(driver):
    """Press Ctrl+W and wait until the sensor is alone."""
    driver.key(Qt.Key.Key_W, CTRL)
    assert driver.window.busy.label.text() == "Closing …"
    driver.wait(lambda: driver.window.windowTitle().startswith("nothing open – "))
    driver.settle()


def test_check_marks_follow_the_state_and_close_leaves_the_sensor_at_rest(drive, sensor):
    source = DentSource(sensor)
    driver = drive(lambda _: source, frame=3)
    state, tools = driver.state, driver.window.tools
    for name, choice in (("Playback › Loop", "loop"), ("Playback › Every frame", "every_frame")):
        before = getattr(state.settings, choice)
        assert driver.ticked(name) == before
        driver.act(name)
        assert getattr(state.settings, choice) is driver.ticked(name) is not before
        driver.window.undo_stack.undo()
        assert driver.ticked(name) == before
    driver.act("Playback › Mark this frame")
    assert state.markers == (3,) and driver.ticked("Playback › Mark this frame")
    driver.seek(4)
    assert not driver.ticked("Playback › Mark this frame")
    for shown in (True, False):
        driver.act("View › Full screen")
        assert driver.ticked("View › Full screen") == driver.window.isFullScreen() == shown
    # those of the tools are those of their panel
    turntable, probe, distance = (
        f"View › {name}" for name in ("Turntable", "Probe a point", "Measure a distance")
    )
    driver.click(tools.turn)
    assert driver.ticked(turntable) and tools.turntable.turning
    driver.act(turntable)
    assert not driver.ticked(turntable) and not tools.turntable.turning
    driver.act(probe)
    assert driver.ticked(probe) and tools.tools["probe"].isChecked() and tools.tool == "probe"
    driver.click(tools.tools["distance"])
    assert driver.ticked(distance) and not driver.ticked(probe)
    driver.act(distance)
    assert not driver.ticked(distance) and tools.tool == "rotate"
    # what has no live source cannot be checked
    for name in ("Playback › Freeze a live source", "Live › Record", "Live › Publish results"):
        assert driver.window.shortcuts.actions[name].isCheckable()
        driver.act(name)
        assert not driver.ticked(name), name
    # a recording is closed by its key, and the sensor stays at rest
    driver.seek(11)
    assert len(driver.warm_pixels()) > 100 and not source.closed
    close(driver)
    assert source.closed and driver.pipeline.model.sensor == sensor
    assert not len(driver.warm_pixels()) and driver.state.facts.frames == 1
    assert driver.window.status.labels["force"].text() == "force –"  # and not 0.00 N
    assert driver.window.status.labels["frame"].text() == "frame –"
    assert driver.window.playback.readout.text() == "frame –"
    assert {"no contact", "no depth data"}.isdisjoint(texts(driver))
    for panel in driver.window.panels.values():
        panel.show()
    driver.choose(kappa=2.0, layers=frozenset(driver.window.layers.boxes))
    assert not driver.window.message.isVisible()
    driver.bot.keyClick(driver.window, Qt.Key.Key_Space)
    driver.bot.keyClick(driver.window, Qt.Key.Key_End)
    close(driver)
    driver.opens("dent", DentSource, sensor, frame=11, playing=False)
    driver.wait(lambda: driver.state.facts.title == "dent")
    driver.settle()
    assert len(driver.warm_pixels()) > 100


def test_a_live_source_is_closed_and_what_was_being_recorded_is_whole(open_bench):
    live = open_bench()
    live.connect(single("synthetic:?frames=6", sensor_file(live.folder)))
    live.record()
    path = live.status().path
    close(live)
    live.wait(lambda: "Recorded" in live.window.notice.label.text())
    assert contents(path) and live.live_controller.run is None
    assert not live.state.playing
