"""Dialogs with text: messages, contents of a recording, documentation."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

from PySide6.QtCore import QRegularExpression, Qt, QUrl
from PySide6.QtGui import QFontDatabase, QPixmap, QResizeEvent, QTextCursor, QTextDocument
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPlainTextEdit,
    QStyle,
    QTextBrowser,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.wording import count_of
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.worker import Worker
from bubbleviz_ui.model.messages import Messages, UserMessage
from bubbleviz_ui.model.source_facts import title_text
from bubbleviz_ui.shell.dock import fill, push_button, resize_on_screen

SIZE = (640, 360)  # px
PAGES_SIZE = (860, 620)
SEARCH = "Enter shows the next place with this text"
HOME = "index.md"


class TextDialog(QDialog):
    """Text with a button to copy all of it."""

    def __init__(self, parent: QWidget, title: str, copied: str) -> None:
        super().__init__(parent)
        self.setWindowTitle(title)
        resize_on_screen(self, *SIZE)
        self.text = QPlainTextEdit(readOnly=True, undoRedoEnabled=False)
        self.copy = push_button(
            "&Copy all", copied, lambda: QApplication.clipboard().setText(self.report())
        )
        fill(QVBoxLayout(self), self.text, fill(QHBoxLayout(), 1, self.copy))

    def report(self) -> str:
        return self.text.toPlainText()


class MessagesDialog(TextDialog):
    """All messages with time and kind, newest last; updated while it is open."""

    def __init__(self, parent: QWidget, messages: Messages) -> None:
        copied = "All messages with their details"
        super().__init__(parent, "Messages of this session", copied)
        self._messages = messages
        self.text.setPlaceholderText("No messages yet")
        self.text.setPlainText("\n".join(message.line() for message in messages.all))
        messages.added.connect(self._add)
        messages.revised.connect(self._revise)

    def report(self) -> str:
        return "\n".join(message.report() for message in self._messages.all)

    def _add(self, message: UserMessage) -> None:
        self.text.appendPlainText(message.line())

    def _revise(self, message: UserMessage, new: UserMessage | None) -> None:
        """Replace one line, which moves neither the view nor the selection."""
        flags, document = QTextDocument.FindFlag, self.text.document()
        back, old = flags.FindBackward | flags.FindCaseSensitively, message.line()
        line = document.find(old, document.characterCount(), back)
        while not line.isNull() and line.block().text() != old:  # begins or ends like it
            line = document.find(old, line, back)
        if new is not None and not line.isNull():
            line.insertText(new.line())


class InformationDialog(TextDialog):
    """Output of `bubbleviz info` for the open recording, or a description of a live source."""

    def __init__(self, parent: QWidget, controller: Controller, worker: Worker) -> None:
        super().__init__(parent, "Information", "All lines shown here")
        self.setWindowModality(Qt.WindowModality.WindowModal)  # closed, it cancels what is read
        self.text.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.text.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        sensor, facts = controller.sensor, controller.state.facts
        source = controller.opening.source
        self._sensor = "" if sensor is None else f"Sensor: {title_text(sensor)}"
        path = None if source is None else source.path
        if path is not None:
            self.text.setPlaceholderText("Reading the recording…")
            worker.submit(
                partial(_contents, path), self._write, lambda failed: self._write(failed.message)
            )
            self.finished.connect(worker.cancel)
        elif facts.is_empty:
            self._write("Nothing is open.")
        else:
            so_far = " so far" if facts.grows else ""
            self._write(f"Source: {facts.title}, {count_of(facts.frames, 'frame')}{so_far}")

    def _write(self, text: str) -> None:
        self.text.setPlainText(f"{self._sensor}\n{text}")


def _contents(path: Path) -> str:
    from bubbleviz.api.frames import info  # slow

    return info(path).to_text()


class _Page(QTextBrowser):
    """A page whose pictures are not wider than it."""

    def __init__(self) -> None:
        super().__init__()
        # one that appears resizes the page, which would be loaded again while Qt still fills it
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOn)

    def loadResource(self, type: int, name: QUrl | str) -> object:
        """Contents of a file; a picture as one that fits."""
        found = super().loadResource(type, name)
        if type != QTextDocument.ResourceType.ImageResource.value:
            return found
        picture, scale = QPixmap(), self.devicePixelRatio()
        picture.loadFromData(found)
        bar = self.style().pixelMetric(QStyle.PixelMetric.PM_ScrollBarExtent)
        room = self.width() - bar - 4 * self.document().documentMargin()
        if picture.width() > room:
            smooth = Qt.TransformationMode.SmoothTransformation
            picture = picture.scaledToWidth(round(room * scale), smooth)
            picture.setDevicePixelRatio(scale)
        return picture

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Fit the pictures to another width."""
        super().resizeEvent(event)
        if event.size().width() != event.oldSize().width():
            place = self.verticalScrollBar().value()
            self.reload()
            self.verticalScrollBar().setValue(place)


class PagesDialog(QDialog):
    """The documentation installed with the program."""

    def __init__(self, parent: QWidget, folder: Path) -> None:
        super().__init__(parent)
        self.setWindowTitle("Documentation")
        self._files = sorted(folder.rglob("*.md"))
        resize_on_screen(self, *PAGES_SIZE)
        self.page = _Page()
        self.page.setOpenExternalLinks(True)
        self.page.setSearchPaths([str(folder)])
        self.home = push_button("&Contents", "First page", self.page.home)
        self.back = push_button("&Back", "Previous page", self.page.backward)
        self.back.setEnabled(False)
        self.page.backwardAvailable.connect(self.back.setEnabled)
        self.search, self.missed = (
            QLineEdit(placeholderText=f"Search all pages. {SEARCH}"),
            QLabel(),
        )
        self.search.setToolTip(SEARCH)
        self.search.returnPressed.connect(self._find_next)
        for button in (self.home, self.back):
            button.setAutoDefault(False)  # Enter searches
        row = fill(QHBoxLayout(), self.home, self.back, (self.search, 1), self.missed)
        fill(QVBoxLayout(self), row, (self.page, 1))
        self.page.setSource(QUrl.fromLocalFile(str(folder / HOME)))
        self.search.setFocus()

    def _find_next(self) -> None:
        """Select the next place with the phrase or, if no page has it, a paragraph of its words."""
        words = [re.escape(word) for word in self.search.text().split()]
        self.missed.clear()
        paragraph = f"^{''.join(f'(?=.*{word})' for word in words)}.+"
        if words and not self._find(r"\s+".join(words)) and not self._find(paragraph):
            self.missed.setText("not found")

    def _find(self, pattern: str) -> bool:
        """Select the next match: in this page, else in the others."""
        wanted = QRegularExpression(pattern)
        if self.page.find(wanted):
            return True
        shown = Path(self.page.source().toLocalFile())
        at = next((k for k, path in enumerate(self._files) if path.samefile(shown)), -1)
        for path in (*self._files[at + 1 :], *self._files[: at + 1]):
            paragraphs = path.read_text(encoding="utf-8").split("\n\n")
            if any(re.search(pattern, " ".join(p.split()), re.IGNORECASE) for p in paragraphs):
                self.page.setSource(QUrl.fromLocalFile(str(path)))
                self.page.moveCursor(QTextCursor.MoveOperation.Start)
                if self.page.find(wanted):  # else it is only in the address of a link
                    return True
        return False
