"""What a recording has in it, and the documentation, in the window."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import Qt, QUrl
from PySide6.QtWidgets import QApplication
from small_press import write_press
from window_driver import Driver

from bubbleviz.api.frames import info
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.source_openers import recording
from bubbleviz_ui.shell.text_dialogs import InformationDialog, PagesDialog

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton


def test_information_is_that_of_the_command_and_names_the_sensor(
    drive: Drive, sensor: Sensor, tmp_path: Path
) -> None:
    path = tmp_path / "press.mcap"
    write_press(path, sensor)
    driver = drive(open_source=recording(path))
    driver.window.shortcuts.actions["File › Information"].trigger()
    (dialog,) = driver.window.findChildren(InformationDialog)
    driver.wait(lambda: bool(dialog.text.toPlainText()))
    driver.bot.mouseClick(dialog.copy, LEFT)
    first, rest = QApplication.clipboard().text().split("\n", 1)
    assert sensor.name in first and rest == info(path).to_text()
    dialog.close()


def test_information_on_what_is_no_file_names_the_source(drive: Drive) -> None:
    driver = drive()
    driver.window.shortcuts.actions["File › Information"].trigger()
    (dialog,) = driver.window.findChildren(InformationDialog)
    text = dialog.text.toPlainText()
    assert driver.state.facts.title in text and "frames" in text
    dialog.close()


def test_documentation_is_read_in_the_window(drive: Drive) -> None:
    driver = drive()
    driver.window.shortcuts.actions["Help › Documentation"].trigger()
    (dialog,) = driver.window.findChildren(PagesDialog)
    assert "Soft-bubble tactile sensors" in dialog.page.toPlainText()
    assert "![" not in dialog.page.toPlainText() and not dialog.back.isEnabled()
    dialog.page.setSource(QUrl("tutorials/first-press.md"))
    assert "First press" in dialog.page.toPlainText()
    driver.bot.mouseClick(dialog.back, LEFT)
    assert dialog.page.source().fileName() == "index.md"
    dialog.close()
