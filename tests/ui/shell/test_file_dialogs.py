"""Files by the dialogs, typed as a person would: nothing is replaced unasked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from fakes import DentSource
from PySide6.QtCore import Qt
from PySide6.QtGui import QAction, QImage
from PySide6.QtWidgets import (
    QApplication,
    QFileDialog,
    QWidget,
)
from window_driver import Driver, typed

from bubbleviz.files.defaults import SESSION_SUFFIX
from bubbleviz.frames.recording_writer import RecordingWriter
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.choices import Choices

Drive = Callable[..., Driver]


def action(driver: Driver, text: str) -> QAction:
    found = [
        a for a in driver.window.findChildren(QAction) if a.text().replace("&", "").startswith(text)
    ]
    assert len(found) == 1, text
    return found[0]


def test_a_session_named_without_its_suffix_is_not_replaced_unasked(
    drive: Drive, tmp_path: Path
) -> None:
    driver = drive()
    precious = tmp_path / f"look{SESSION_SUFFIX}"
    precious.write_text("precious")
    save = action(driver, "Save session as")
    assert typed(driver, save.trigger, str(tmp_path / "look")) == ["dialog", "question"]
    assert precious.read_text() == "precious"
    assert typed(driver, save.trigger, str(tmp_path / "other")) == ["dialog"]
    assert (tmp_path / f"other{SESSION_SUFFIX}").is_file()


def test_space_plays_what_was_opened_by_the_dialog(
    drive: Drive, sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(parent: QWidget, title: str, folder: str, kinds: str) -> tuple[str, str]:
        dialog = QFileDialog(parent, title, folder, kinds)
        chosen = dialog.selectedFiles() if dialog.exec() else [""]
        dialog.deleteLater()
        return chosen[0], ""

    # Qt's own dialog lives on its stack, where Python must not hold it
    monkeypatch.setattr(QFileDialog, "getOpenFileName", asked)
    source = DentSource(sensor)
    with RecordingWriter(tmp_path / "press.mcap") as writer:
        for k in range(len(source)):
            writer.write(source[k])
    driver = drive()
    loop, state = driver.window.playback.loop, driver.state
    with driver.bot.waitActive(driver.window):
        driver.window.activateWindow()
    loop.setFocus()  # as by Tab; Space there is a click on it
    typed(driver, action(driver, "Open recording…").trigger, str(tmp_path / "press.mcap"))
    driver.wait(lambda: state.facts.title == "press.mcap")
    with driver.bot.waitActive(driver.window):
        driver.window.activateWindow()
    driver.wait(lambda: QApplication.focusWidget() is not None)
    state.set_playing(False)
    driver.bot.keyClick(QApplication.focusWidget(), Qt.Key.Key_Space)
    assert state.playing and loop.isChecked() == state.choices.loop == Choices().loop
    state.set_playing(False)
    loop.setFocus()
    state.choose(solver="fast")  # the same source, solved anew: who is at a box stays there
    driver.settle()
    assert QApplication.focusWidget() is loop


def test_a_picture_named_without_suffix_is_a_png(drive: Drive, tmp_path: Path) -> None:
    driver = drive()
    for name in ("shot", "shot.v2"):
        before = set(tmp_path.iterdir())
        typed(driver, action(driver, "Screenshot").trigger, str(tmp_path / name))
        (path,) = set(tmp_path.iterdir()) - before
        assert path.name in ("shot.png", "shot.v2")
        assert path.read_bytes().startswith(b"\x89PNG") and not QImage(str(path)).isNull()
        assert str(path) in driver.window.notice.label.text()
        assert not driver.window.message.isVisible()


def test_a_dialog_comes_back_to_the_last_folder_of_its_kind(
    drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = drive()
    asked: list[tuple[str, str]] = []
    answers = {"Open recording": "records/a.mcap", "Open sensor": "sensors/b.toml"}

    def chosen(_: object, title: str, folder: str, *__: object) -> tuple[str, str]:
        asked.append((title, folder))
        return str(tmp_path / answers[title]), ""

    monkeypatch.setattr(QFileDialog, "getOpenFileName", chosen)
    for name in answers.values():
        (tmp_path / name).parent.mkdir()
    for _ in range(2):
        for title in answers:
            driver.window.shortcuts.actions[f"File › {title}"].trigger()
    assert asked[2:] == [(title, str((tmp_path / name).parent)) for title, name in answers.items()]
    driver.wait(driver.window.message.isVisible)  # neither is there
    (tmp_path / "records").rmdir()
    driver.window.shortcuts.actions["File › Open recording"].trigger()
    assert asked[-1] == ("Open recording", "")
