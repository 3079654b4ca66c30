"""Waiting with a way out, and what a new user is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Event

from fakes import DentSource
from PySide6.QtCore import Qt
from window_driver import Driver

from bubbleviz.sensor import Sensor
from bubbleviz_ui.session_files.session_file import read_user_file

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton


class SlowOpener:
    """Opens when it is let."""

    def __init__(self) -> None:
        self.go, self.begun = Event(), Event()
        self.source: DentSource | None = None

    def __call__(self, sensor: Sensor) -> DentSource:
        self.begun.set()
        assert self.go.wait(20)
        self.source = DentSource(sensor)
        return self.source


def test_opening_that_takes_long_says_so_and_can_be_left(drive: Drive) -> None:
    driver = drive(frame=5)
    window, opener = driver.window, SlowOpener()
    title = window.windowTitle()
    sensor = window.controller.sensor
    window.controller.opening.open("slow.mcap", opener, lambda: sensor)
    driver.wait(window.busy.isVisible)
    assert "slow.mcap" in window.busy.label.text()
    driver.state.seek(6)
    driver.bot.mouseClick(window.busy.cancel, LEFT)
    assert not window.busy.isVisible()
    driver.wait(opener.begun.is_set)
    opener.go.set()
    driver.wait(lambda: opener.source is not None and opener.source.closed)
    driver.settle()
    assert window.windowTitle() == title and driver.state.frame == 6
    assert not window.message.isVisible()


def test_opening_ends_the_bar(drive: Drive) -> None:
    driver = drive(frame=5)
    window, opener = driver.window, SlowOpener()
    sensor = window.controller.sensor
    window.controller.opening.open("slow.mcap", opener, lambda: sensor, playing=False)
    driver.wait(window.busy.isVisible)
    opener.go.set()
    driver.wait(lambda: driver.state.facts.title == "dent")
    assert not window.busy.isVisible()


def test_another_file_is_opened_in_place_of_one_that_takes_long(drive: Drive) -> None:
    driver = drive(frame=5)
    window, opener = driver.window, SlowOpener()
    sensor = window.controller.sensor
    window.controller.opening.open("slow.mcap", opener, lambda: sensor)
    driver.wait(opener.begun.is_set)
    window.controller.opening.open("dent", DentSource, lambda: sensor, frame=3, playing=False)
    opener.go.set()
    driver.wait(lambda: driver.state.facts.title == "dent" and driver.state.frame == 3)
    assert opener.source is not None and opener.source.closed
    assert not window.busy.isVisible()


def test_the_hint_is_shown_until_it_is_read(drive: Drive, tmp_path: Path) -> None:
    driver = drive(frame=5)
    window, file = driver.window, tmp_path / "session.json"
    assert not window.hint.isVisible()
    window.session_saver.keep_in(file)
    assert window.hint.isVisible() and "Ctrl+K" in window.hint.label.text()
    window.session_saver.save()
    assert not read_user_file(file).hinted
    driver.bot.mouseClick(window.hint.understood, LEFT)
    assert not window.hint.isVisible()
    window.session_saver.save()
    assert read_user_file(file).hinted
    window.session_saver.keep_in(file)
    assert not window.hint.isVisible()
    window.shortcuts.actions["Help › First steps"].trigger()
    assert window.hint.isVisible()
