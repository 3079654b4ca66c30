"""Menus: check marks follow what they turn on and off; Close closes what is open."""

from fakes import DentSource
from live_bench import messages_by_type, sensor_file
from PySide6.QtCore import QSize, Qt, QTimer
from PySide6.QtGui import QScreen, QTextDocument
from PySide6.QtWidgets import QApplication, QDialog, QInputDialog, QTextBrowser
from shiboken6 import isValid
from window_driver import CTRL, view_texts

from bubbleviz.files import pages_folder
from bubbleviz_ui.live.connection import single


def close(driver):
    """Press Ctrl+W and wait until the sensor is alone."""
    driver.key(Qt.Key.Key_W, CTRL)
    assert driver.window.busy.label.text() == "Closing …"
    driver.wait(lambda: driver.window.windowTitle().startswith("nothing open – "))
    driver.wait_until_shown()


def test_check_marks_follow_the_state_and_close_shows_the_sensor_at_rest(drive, sensor):
    source = DentSource(sensor)
    driver = drive(lambda _: source, frame=3)
    state, tools = driver.state, driver.window.tools
    for name, choice in (("Playback › Loop", "loop"), ("Playback › Every frame", "every_frame")):
        before = getattr(state.settings, choice)
        assert driver.is_checked(name) == before
        driver.trigger(name)
        assert getattr(state.settings, choice) is driver.is_checked(name) is not before
        driver.window.undo_stack.undo()
        assert driver.is_checked(name) == before
    driver.trigger("Playback › Mark this frame")
    assert state.markers == (3,) and driver.is_checked("Playback › Mark this frame")
    driver.seek(4)
    assert not driver.is_checked("Playback › Mark this frame")
    for shown in (True, False):
        driver.trigger("View › Full screen")
        assert driver.is_checked("View › Full screen") == driver.window.isFullScreen() == shown
    # those of the tools are those of their panel
    turntable, probe, distance = (
        f"View › {name}" for name in ("Turntable", "Probe a point", "Measure distance and profile")
    )
    driver.click(tools.turn)
    assert driver.is_checked(turntable) and tools.turntable.isActive()
    driver.trigger(turntable)
    assert not driver.is_checked(turntable) and not tools.turntable.isActive()
    driver.trigger(probe)
    assert driver.is_checked(probe) and tools.tools["probe"].isChecked() and tools.tool == "probe"
    driver.click(tools.tools["distance"])
    assert driver.is_checked(distance) and not driver.is_checked(probe)
    driver.trigger(distance)
    assert not driver.is_checked(distance) and tools.tool == "rotate"
    # what has no live source cannot be checked
    for name in ("Playback › Freeze a live source", "Live › Record", "Live › Publish results"):
        assert driver.window.shortcuts.actions[name].isCheckable()
        driver.trigger(name)
        assert not driver.is_checked(name), name
    # a recording is closed by its key, and the sensor stays at rest
    driver.seek(11)
    assert len(driver.pressure_pixels()) > 100 and not source.closed
    close(driver)
    assert source.closed and driver.pipeline.model.sensor == sensor
    assert not len(driver.pressure_pixels()) and driver.state.facts.frames == 1
    assert driver.window.status.labels["force"].text() == "force –"  # and not 0.00 N
    assert driver.window.status.labels["frame"].text() == "frame –"
    assert driver.window.playback.readout.text() == "frame –"
    assert {"no contact", "no depth data"}.isdisjoint(view_texts(driver))
    for panel in driver.window.panels.values():
        panel.show()
    assert not driver.window.plots.analyse.isEnabled()
    driver.choose(kappa=2.0, layers=frozenset(driver.window.layers.boxes))
    assert not driver.window.message.isVisible()
    driver.bot.keyClick(driver.window, Qt.Key.Key_Space)
    driver.bot.keyClick(driver.window, Qt.Key.Key_End)
    close(driver)
    driver.show_source(DentSource, sensor, frame=11)
    assert len(driver.pressure_pixels()) > 100


def test_closing_a_live_source_completes_its_recording(open_bench):
    live = open_bench()
    live.connect(single("synthetic:?frames=6", sensor_file(live.folder)))
    live.record()
    path = live.status().path
    close(live)
    live.wait(lambda: "Recorded" in live.window.notice.label.text())
    assert messages_by_type(path) and live.live_controller.run is None
    assert not live.state.playing


PICTURE = (pages_folder() / "press.webp").as_uri()
DIALOGS = (
    *("File › Information", "File › Import", "File › Export", "Edit › Settings"),
    *("Playback › Contacts", "Live › Connect", "Help › Documentation"),
    *("Help › Keyboard shortcuts", "Help › Messages", "Help › About bubbleviz"),
)


def test_dialogs_fit_a_screen_of_1024_by_700_at_150_percent_and_are_deleted_when_closed(
    drive, monkeypatch
):
    screen = QSize(683, 467)
    monkeypatch.setattr(QScreen, "availableSize", lambda _: screen)
    driver = drive(DentSource, frame=6)
    for name in DIALOGS:
        driver.trigger(name)
        driver.wait(lambda: any(each.isVisible() for each in driver.window.findChildren(QDialog)))
        (dialog,) = (each for each in driver.window.findChildren(QDialog) if each.isVisible())
        assert screen.expandedTo(dialog.frameSize()) == screen, (name, dialog.frameSize())
        for page in dialog.findChildren(QTextBrowser):
            picture = page.loadResource(QTextDocument.ResourceType.ImageResource.value, PICTURE)
            assert picture.deviceIndependentSize().width() <= page.viewport().width()
        dialog.close()
        if name not in ("File › Import", "File › Export"):  # which keep what was entered
            driver.wait(lambda dialog=dialog: not isValid(dialog))
    sizes, timer = [], QTimer(interval=20)

    def measure():
        dialog = QApplication.activeModalWidget()
        if isinstance(dialog, QInputDialog):
            sizes.append(dialog.frameSize())
            dialog.reject()

    timer.timeout.connect(measure)
    timer.start()
    for name in ("Playback › Go to frame", "Live › Publish at"):  # return when answered
        driver.trigger(name)
    timer.stop()
    assert len(sizes) == 2 and all(screen.expandedTo(size) == screen for size in sizes)
