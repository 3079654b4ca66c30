"""Session files: saving, restoring, moving to another folder, recovery after a kill."""

import gc
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from fakes import FRAMES, DentSource
from PySide6.QtCore import QPoint

from bubbleviz.errors import InputError
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.engine.solver import Opened
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.session_files.session_file import (
    SavedSession,
    plain_settings,
    read_session,
    read_user_file,
    usable_settings,
)
from bubbleviz_ui.window_session import Startup, window_session


def change(driver):
    """Change settings of every kind."""
    driver.state.change(
        kappa=2.5, speed=0.5, pressure_max_pa=4000.0, cloud_colour="plain", theme="light",
        layers=frozenset({"membrane", "rim"}), plots=frozenset({"force"}),
    )  # fmt: skip
    driver.state.set_markers((3, 9))
    driver.state.set_range((2, 10))
    driver.show("plots")
    driver.window.panels["layers"].hide()
    driver.window.view.camera.position = (0.3, 0.2, 0.1)
    driver.wait_until_shown()


def check(driver):
    """Check that everything changed by `change` is restored."""
    driver.wait(lambda: driver.state.facts.frames == FRAMES)
    state, choices = driver.state, driver.state.settings
    driver.wait_until_shown()
    assert (state.frame, state.markers, state.play_range) == (7, (3, 9), (2, 10))
    assert (choices.kappa, choices.speed, choices.pressure_max_pa) == (2.5, 0.5, 4000.0)
    assert choices.layers == {"membrane", "rim"} and choices.plots == {"force"}
    assert driver.window.panels["plots"].isVisible() and driver.window.panels["layers"].isHidden()
    assert driver.window.view.camera.position == pytest.approx((0.3, 0.2, 0.1))
    assert driver.shows_chosen_kappa()
    assert driver.window.controller.sensor.name == "small dome"


def test_layout_with_tabs_is_restored_into_a_window_that_was_not_shown(
    drive, new_window, files, open_press, qtlog
):
    """As at the start of the program; a change of docks meanwhile has crashed Qt."""
    driver = drive()
    open_press(driver, frame=7)
    driver.resize_to_smallest()
    driver.window.use_scene(load_scene("review"))
    for name in ("images", "calibration", "tools"):  # each is laid out before the next one
        driver.show(name)
        driver.wait_until_shown()
    driver.window.session_saver.save_as(files / "look.bubbleviz")
    window = new_window()
    window.session_saver.apply_settings(read_session(files / "look.bubbleviz"))
    assert not [record.message for record in qtlog.records if "resizeDocks" in record.message]
    window.show()
    assert window.open_panels == driver.window.open_panels
    tabs = lambda shown: {each.windowTitle() for each in shown}  # noqa: E731
    for name in ("plots", "kappa"):
        ours, theirs = (each.panels[name] for each in (driver.window, window))
        assert tabs(window.tabifiedDockWidgets(theirs)) == tabs(
            driver.window.tabifiedDockWidgets(ours)
        )


def test_plots_are_as_high_again_at_each_start(drive, new_window):
    """Also those that opened in a window with too little room for their height."""
    driver = drive(DentSource)
    driver.window.use_scene(load_scene("review"))
    driver.resize(1280, 900)
    driver.wait_until_shown()
    window = driver.window
    height = window.panels["plots"].height()
    for _ in range(2):
        window.resize(675, 427)
        driver.wait(lambda shown=window: shown.panels["plots"].height() < height)
        saved = window.session_saver.snapshot()
        window = new_window()
        window.session_saver.apply_settings(saved)
        window.show()
        driver.wait(lambda shown=window: shown.panels["plots"].height() < height)
        window.resize(1280, 900)
        driver.wait(lambda shown=window: shown.panels["plots"].height() >= height)


def test_session_file_restores_elsewhere_with_or_without_its_recording(
    drive, files, open_press, tmp_path
):
    mine = drive()
    open_press(mine, frame=7)
    change(mine)
    mine.window.session_saver.save_as(files / "look.bubbleviz")
    text = (files / "look.bubbleviz").read_text()
    assert str(files) not in text  # no local paths
    theirs = tmp_path / "elsewhere"
    shutil.copytree(files, theirs)
    other = drive()
    other.window.files.open(theirs / "look.bubbleviz")
    check(other)
    assert not any("missing" in each.text for each in other.window.messages.all)
    assert other.state.settings.theme == "system"  # their own setting is kept
    # a missing file gives a message, and the rest is restored
    mine.window.session_saver.save_as(files / "alone.bubbleviz")
    shutil.copy(files / "alone.bubbleviz", tmp_path)
    (files / "alone.bubbleviz").unlink()
    other.state.change(kappa=None)
    other.show("layers")
    other.seek(5)
    other.window.files.open(tmp_path / "alone.bubbleviz")
    message = other.window.message
    assert message.isVisible()
    assert "press.mcap is missing" in message.label.text()
    assert message.label.text().count(".") <= 6 and "\n" not in message.label.text()
    assert other.state.settings.kappa == 2.5 and other.window.panels["layers"].isHidden()
    assert other.state.frame == 5  # the open source stays


def test_unknown_settings_of_another_version_are_ignored():
    mine = Settings(kappa=2.0, speed=4.0, layers=frozenset({"rim"}), theme="light")
    assert usable_settings(json.loads(json.dumps(plain_settings(mine)))) == mine
    fields_ = plain_settings(mine)
    strange = {**fields_, "speed": 3.0, "theme": "pink", "new": 1, "layers": ["rim", "aura"],
               "solver": "oracle", "view_from": [1, 2], "kappa": "x"}  # fmt: skip
    got = usable_settings(strange)
    assert got.layers == {"rim"} and got.speed == 1.0 and got.solver is None
    assert got.theme == "system" and got.kappa is None and got.view_from == Settings().view_from


def test_every_setting_is_in_the_session_file():
    assert plain_settings(Settings()).keys() == {f.name for f in fields(Settings)}


def test_unreadable_session_is_renamed(tmp_path):
    file = tmp_path / "session.json"
    file.write_text("{")
    with pytest.raises(InputError, match=r"session\.json.*kept as session\.unreadable"):
        read_user_file(file)
    assert read_user_file(file).session == SavedSession()
    assert (tmp_path / "session.unreadable").read_text() == "{"


def test_saved_and_foreign_sessions_recent_files_and_reload(drive, files, open_press, tmp_path):
    driver = drive(frame=3)
    saver, view = driver.window.session_saver, driver.window.view
    assert saver.snapshot().camera is None
    driver.drag(view, view.rect().center(), view.rect().center() + QPoint(40, 20))
    saved = saver.snapshot().camera
    assert saved is not None and saved.position == pytest.approx(view.camera.position)
    saver.save_as(tmp_path / "a.bubbleviz")
    assert (tmp_path / "a.bubbleviz").stat().st_size < 20_000
    assert read_session(tmp_path / "a.bubbleviz").frame == 3
    # a foreign file changes neither the publishing endpoint nor the recording folder
    saved = read_session(tmp_path / "a.bubbleviz")
    choices = {**saved.choices, "publish_at": "tcp/0.0.0.0:7448", "record_folder": "/"}
    crafted = saved.model_copy(update={"choices": choices})
    (tmp_path / "b.bubbleviz").write_text(crafted.model_dump_json())
    driver.window.files.open(tmp_path / "b.bubbleviz")
    assert driver.state.settings.publish_at.startswith("tcp/127.0.0.1")
    assert driver.window.live_controller.publishing.endpoint.startswith("tcp/127.0.0.1")
    assert driver.state.settings.record_folder is None
    # an invalid file gives a message
    bad = tmp_path / "bad.bubbleviz"
    bad.write_text("not json")
    driver.window.files.open(bad)
    assert driver.window.message.isVisible() and "bad.bubbleviz" in driver.message_text
    # recent files and reload
    driver.window.message.hide()
    window, copy = driver.window, tmp_path / "press.mcap"
    shutil.copy(files / "press.mcap", copy)
    open_press(driver, tmp_path, frame=5)
    menu = driver.menu("File", "Open recent")
    sessions = [tmp_path / f"{name}.bubbleviz" for name in "ba"]
    assert [Path(a.text()) for a in menu.actions()] == [copy, files / "dome.toml", *sessions]
    driver.state.set_markers((1,))
    gone = window.controller.client.session
    driver.trigger("File › Reload")
    driver.wait(lambda: window.controller.client.session is not gone)
    driver.wait_until_shown()
    assert driver.state.frame == 5 and driver.state.markers == (1,)
    driver.state.set_range((2, 10))
    open_press(driver)  # not applied to another recording of the same name
    assert driver.state.facts.title == "press.mcap"
    assert not driver.state.markers and driver.state.play_range is None
    open_press(driver, tmp_path)
    copy.unlink()
    driver.trigger("File › Reload")
    driver.wait_for_message("press.mcap")


KILLED = """
import os, sys
sys.path.insert(0, {here!r})
from pathlib import Path
from bubbleviz.sensor import load_sensor
from bubbleviz_ui import session_saver
from bubbleviz_ui.window_session import Startup, window_session
from bubbleviz_ui.session_saver import user_file
session_saver.EVERY_MS = 100
with window_session(Startup(load_sensor({sensor!r}), Path({rec!r})), user_file) as session:
    state = session.state
    session.window.show()
    state.set_playing(False)
    state.seek(6)
    state.change(kappa=1.75)
    state.toggle_marker(4)
    session.window.shortcuts.set_keys("View › Reset view", "Ctrl+J")
    print("ready", flush=True)
    session.application.exec()
"""


def run(files, config, rec):
    code = KILLED.format(
        here=str(Path(__file__).parents[1]), rec=str(rec), sensor=str(files / "dome.toml")
    )
    code = code.replace('"Ctrl+J")', '__import__("PySide6.QtGui").QtGui.QKeySequence("Ctrl+J"))')
    return subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "XDG_CONFIG_HOME": str(config)}, cwd=Path(__file__).parents[3],
    )  # fmt: skip


def test_session_is_restored_after_a_kill(qtbot, files, tmp_path, eventually):
    rec = tmp_path / "press.mcap"
    shutil.copy(files / "press.mcap", rec)
    process = run(files, tmp_path / "config", rec)
    assert process.stdout.readline() == "ready\n", process.communicate()[1]
    file = tmp_path / "config" / "bubbleviz" / "session.json"
    eventually(lambda: file.exists() and "1.75" in file.read_text())
    process.send_signal(signal.SIGKILL)
    process.communicate()
    with window_session(Startup(load_sensor(files / "dome.toml")), lambda: file) as again:
        state, window = again.state, again.window
        window.show()
        assert Path(state.facts.title).name == "press.mcap"
        assert (state.frame, state.markers, state.settings.kappa) == (6, (4,), 1.75)
        assert window.shortcuts.keys("View › Reset view") == "Ctrl+J"
        assert not window.message.label.text()


def test_closed_source_is_freed_from_memory(qtbot, files):
    """Each result holds camera rays and a frame: 15 MiB for a RealSense."""
    sensor = load_sensor(files / "dome.toml")
    with window_session(Startup(sensor, files / "press.mcap", 3)) as session:
        controller = session.controller
        for frame in (1, 2, 3, 4):
            was = controller.client.session
            dent = Source("dent", DentSource)
            controller.opening.open(dent, lambda: sensor, frame=frame, playing=False)
            session.wait_for(lambda was=was: controller.client.session is not was, "opening")
        gc.collect()
        kept = sum(isinstance(thing, Opened) for thing in gc.get_objects())
        assert kept <= 1
