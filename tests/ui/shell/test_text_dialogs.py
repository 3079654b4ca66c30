"""What a recording has in it, and the documentation, in the window."""

from fakes import DentSource
from PySide6.QtCore import QUrl
from small_press import write_press
from window_driver import clipboard_text

from bubbleviz.api.frames import info
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.shell.text_dialogs import InformationDialog, PagesDialog


def test_information_and_documentation_dialogs(drive, sensor, tmp_path):
    path = tmp_path / "press.mcap"
    write_press(path, sensor)
    driver = drive(open_source=Source.of_recording(path))

    def opened():
        driver.trigger("File › Information")
        dialog = driver.window.findChildren(InformationDialog)[-1]
        driver.wait(lambda: bool(dialog.text.toPlainText()))
        return dialog

    dialog = opened()
    driver.click(dialog.copy)
    first, rest = clipboard_text().split("\n", 1)
    assert sensor.name in first and rest == info(path).to_text()
    dialog.close()
    driver.open("dent", DentSource, sensor, playing=False)  # of what is no file
    driver.wait(lambda: driver.state.facts.title == "dent")
    dialog = opened()
    assert "dent" in dialog.text.toPlainText() and "frames" in dialog.text.toPlainText()
    dialog.close()
    driver.trigger("Help › Documentation")
    (dialog,) = driver.window.findChildren(PagesDialog)
    assert "Soft-bubble tactile sensors" in dialog.page.toPlainText()
    assert "![" not in dialog.page.toPlainText() and not dialog.back.isEnabled()
    dialog.page.setSource(QUrl("tutorials/first-press.md"))
    assert "First press" in dialog.page.toPlainText()
    driver.click(dialog.back)
    assert dialog.page.source().fileName() == "index.md"
    dialog.close()
