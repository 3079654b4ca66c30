"""What a recording has in it, and the documentation, in the window."""

from fakes import DentSource
from PySide6.QtCore import QSizeF, Qt, QUrl
from PySide6.QtGui import QTextDocument
from PySide6.QtWidgets import QMessageBox
from small_press import write_press
from window_driver import clipboard_text

import bubbleviz
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
    # pictures fit, also in another width
    for width in (900, 500):
        dialog.resize(width, 500)
        pictures = [each for each in images(dialog.page) if each.width() > 300]
        assert pictures and all(each.width() <= dialog.page.viewport().width() for each in pictures)
    dialog.page.setSource(QUrl("tutorials/first-press.md"))
    assert "First press" in dialog.page.toPlainText()
    title = dialog.page.document().begin()
    assert heights(title)[0] > 1.5 * heights(title.next())[0]  # only the title is large
    driver.click(dialog.back)
    assert dialog.page.source().fileName() == "index.md"
    # search through all pages, from place to place and around
    driver.type(dialog.search, "PRE-stretch")
    seen = list[tuple[str, int]]()
    while (place := at(dialog.page)) not in seen:
        seen.append(place)
        assert dialog.page.textCursor().selectedText().lower() == "pre-stretch"
        driver.bot.keyClick(dialog.search, Qt.Key.Key_Return)
    assert "glossary.md" in {name for name, _ in seen} and len(seen) > 2
    assert not dialog.missed.text()
    # words that stand in one paragraph, in no page next to each other
    driver.type(dialog.search, "interval FORCE recording")
    found = dialog.page.textCursor().selectedText().lower()
    assert all(word in found for word in ("interval", "force", "recording"))
    assert not dialog.missed.text()
    driver.type(dialog.search, "no page has wxyz")
    assert dialog.missed.text() == "not found"
    dialog.close()
    driver.trigger("Help › About bubbleviz")
    (about,) = driver.window.findChildren(QMessageBox)
    assert bubbleviz.__version__ in about.text() and "Qt 6" in about.informativeText()
    assert driver.window.view.quality.text in about.informativeText()
    about.accept()


def images(page):
    """Sizes of the pictures of a page as laid out."""
    document, place = page.document(), page.document().begin()
    found = list[QSizeF]()
    while place.isValid():
        for part in place:
            form = part.fragment().charFormat()
            if form.isImageFormat():
                kind, name = (
                    QTextDocument.ResourceType.ImageResource.value,
                    form.toImageFormat().name(),
                )
                found.append(document.resource(kind, QUrl(name)).deviceIndependentSize())
        place = place.next()
    return found


def heights(block):
    """Height of each line of a paragraph."""
    return [block.layout().lineAt(k).height() for k in range(block.layout().lineCount())]


def at(page):
    """Page and position of the selected text."""
    return page.source().fileName(), page.textCursor().selectionStart()
