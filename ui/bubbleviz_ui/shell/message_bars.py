"""Bars above the view: errors and warnings, progress, first-run hint, notices; step buttons."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from html import escape
from pathlib import Path

from PySide6.QtCore import QSize, Qt, QTimer, Signal
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import (
    QApplication,
    QButtonGroup,
    QFrame,
    QHBoxLayout,
    QLabel,
    QMenuBar,
    QProgressBar,
    QScrollArea,
    QWidget,
)

from bubbleviz_ui.model.messages import UserMessage
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import BarLayout, Elided, fill, push_button, tool_button

BUSY_AFTER_MS = 1000
"""Delay before the progress bar appears; shorter waits need no feedback (Nielsen 1993)."""
NOTICE_MS = 6000
"""Duration of a notice, enough to read a path and click a button."""
GAP = 16
"""Distance of a notice from the menus, screen pixels."""
MOST_LINES = 2
"""Lines of a text seen without scrolling: the 3-D view keeps its height in a small window."""
HINT = "Drop a recording or press Ctrl+O. Space plays, ← → step; Ctrl+K: commands."


class ScrolledText(QScrollArea):
    """A text in lines, scrolled beyond `MOST_LINES`; its tool tip has all."""

    def __init__(self) -> None:
        super().__init__(widgetResizable=True)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self._label = QLabel(wordWrap=True)
        self.setWidget(self._label)
        for each in (self._label, self.viewport()):
            each.setAutoFillBackground(False)  # the bar has its own colour

    def text(self) -> str:
        return self._label.text()

    def setText(self, text: str) -> None:
        """Show a text, unless it is shown."""
        if text == self._label.text():
            return
        self._label.setText(text)
        self.setToolTip(f"<p>{escape(text)}</p>")  # HTML is wrapped
        self.updateGeometry()

    def hasHeightForWidth(self) -> bool:
        """Of a narrower text."""
        return True

    def heightForWidth(self, width: int) -> int:
        """Height of the lines seen, screen pixels."""
        most = MOST_LINES * self.fontMetrics().lineSpacing()
        return min(self._label.heightForWidth(width), most)

    def sizeHint(self) -> QSize:
        """Size of the text in one line."""
        return self.fontMetrics().size(Qt.TextFlag.TextSingleLine, self._label.text())

    def minimumSizeHint(self) -> QSize:
        """Width of the longest word, height of a line."""
        return self._label.minimumSizeHint()


class _Bar(QFrame):
    """A line of text with buttons; initially hidden."""

    def __init__(self, parent: QWidget, *widgets: QWidget) -> None:
        super().__init__(parent)
        self.kind, self.label = theme.bold(QLabel()), ScrolledText()
        text = QWidget()
        fill(QHBoxLayout(text), self.kind, (self.label, 1), margins=(0, 0, 0, 0))
        BarLayout(self, text, *widgets, margins=(12, 6, 8, 6))
        self.kind.hide()
        self.hide()


class MessageBar(_Bar):
    """Warnings and errors until they are dismissed: errors first, then the newest."""

    def __init__(self, parent: QWidget) -> None:
        self._open: list[UserMessage] = []
        self.more = push_button("", "All messages of this session")
        self.copy = push_button(
            "Copy details",
            "Copy the open messages with details, for a bug report",
            lambda: QApplication.clipboard().setText("\n".join(m.report() for m in self._open)),
        )
        self.dismiss = push_button(
            "Dismiss",
            "Remove this message; Help → Messages lists all",
            lambda: self.keep(lambda message: message is not self._shown),
        )
        super().__init__(parent, self.more, self.copy, self.dismiss)
        self.kind.show()
        self.setAutoFillBackground(True)

    def show_message(self, message: UserMessage) -> None:
        """Show a message; a repeated one replaces the earlier."""
        same = (message.kind, message.text)
        self._open = [other for other in self._open if (other.kind, other.text) != same]
        self._open.append(message)
        self._show_open()

    def revise(self, message: UserMessage, new: UserMessage | None) -> None:
        """Show a message in place of another, or none, unless that was dismissed."""
        revised = [new if other is message else other for other in self._open]
        self._open = [other for other in revised if other is not None]
        self._show_open()

    def drop_topic(self, topic: str) -> None:
        """Remove messages of a topic, after a success."""
        self.keep(lambda message: message.topic != topic)

    @property
    def _shown(self) -> UserMessage:
        errors = [message for message in self._open if message.kind == "error"]
        return (errors or self._open)[-1]

    def keep(self, wanted: Callable[[UserMessage], bool]) -> None:
        self._open = [message for message in self._open if wanted(message)]
        self._show_open()

    def _show_open(self) -> None:
        self.setVisible(bool(self._open))
        if not self._open:
            return
        shown = self._shown
        self.setBackgroundRole(theme.ERROR if shown.kind == "error" else theme.WARNING)
        self.kind.setText(shown.kind.capitalize())
        self.label.setText(shown.text)
        self.more.setText(f"{len(self._open) - 1} more…")
        self.more.setVisible(len(self._open) > 1)
        self.copy.setVisible(any(message.details for message in self._open))


class NoticeBar(QFrame):
    """Notice of a success for some seconds, with the file that was written.

    It is shown in the free part of the menu bar, so that nothing below moves.
    """

    open_requested = Signal(object)  # Path of a file or folder to open

    def __init__(self, bar: QMenuBar) -> None:
        super().__init__(bar)
        self._bar, self._room = bar, QSize()
        self._file: Path | None = None
        self.label = Elided(Qt.TextElideMode.ElideRight)  # the name of a file comes first
        self.open = tool_button(
            "Open",
            "Open the file here, or in the desktop's program for its kind",
            lambda: self.open_requested.emit(self._file),
        )
        self.folder = tool_button(
            "Show in folder",
            "Open the folder of the file",
            lambda: self.open_requested.emit(self._file and self._file.parent),
        )
        self.dismiss = tool_button("Dismiss", "Close; Help → Messages lists all", self.hide)
        buttons = self.open, self.folder, self.dismiss
        for button in buttons:
            button.setAutoRaise(True)
        fill(QHBoxLayout(self), (self.label, 1), *buttons, margins=(8, 0, 4, 0), spacing=2)
        self._due = QTimer(self)
        self._due.timeout.connect(self._hide_unless_hovered)
        self.hide()
        bar.setCornerWidget(self)

    def sizeHint(self) -> QSize:
        """At most the free space of the menu bar."""
        return super().sizeHint().boundedTo(self._room)

    def minimumSizeHint(self) -> QSize:
        return self.sizeHint()

    def show_message(self, message: UserMessage) -> None:
        """Show a message in place of the previous one."""
        self._file = None if message.file is None else message.file.absolute()
        folder = "" if message.file is None else f"{message.file.parent}/"
        self.label.setText(message.text.replace(folder, ""))
        self.label.setToolTip(message.text)
        for button in (self.open, self.folder):
            button.setVisible(self._file is not None)
        self._due.start(NOTICE_MS)
        self.hide()
        menus = self._bar.actionGeometry(self._bar.actions()[-1])
        self._room = QSize(self._bar.width() - menus.right() - GAP, menus.height())
        self.show()

    def _hide_unless_hovered(self) -> None:
        if not self.underMouse():  # else the user may be about to click
            self._due.stop()
            self.hide()


class BusyBar(_Bar):
    """Progress of opening or closing, shown if it takes a while."""

    def __init__(self, parent: QWidget) -> None:
        self.progress = QProgressBar(minimum=0, maximum=0)
        self.progress.setFixedWidth(160)
        self.cancel = push_button("Cancel", "Stop; the current source stays open")
        super().__init__(parent, self.progress, self.cancel)
        self._due = QTimer(self, singleShot=True, interval=BUSY_AFTER_MS)
        self._due.timeout.connect(self.show)

    def wait_for(self, what: str) -> None:
        """Show a progress text after a delay; empty: finished."""
        self.label.setText(what)
        if what and not self.isVisible():
            self._due.start()
        elif not what:
            self._due.stop()
            self.hide()


class JobProgress(QProgressBar):
    """Progress of a job in a thread."""

    def __init__(self) -> None:
        super().__init__(minimum=0, maximum=100)

    def show_step(self, step: str, done: float) -> None:
        """Show the description of a step, and the completed share."""
        self.setFormat(f"{step} %p %")
        self.setValue(round(100.0 * done))


class HintBar(_Bar):
    """First-run hint."""

    def __init__(self, parent: QWidget) -> None:
        self.understood = push_button("Got it", "", self.hide)
        super().__init__(parent, self.understood)
        self.label.setText(HINT)


# A row of step buttons with number, name and state.

SMALL = 8
"""Size of the font, pt: seven names fit in a panel of 380 pixels."""


class StepState(Enum):
    """State of a step; the value is the mark on its button."""

    TO_DO = ""
    DONE = " ✓"
    NEEDS_ATTENTION = " !"


class StepButtons(QButtonGroup):
    """Exclusive buttons of the steps.

    `titles`: Full titles by the name on the button.
    """

    def __init__(self, parent: QWidget, titles: Mapping[str, str]) -> None:
        super().__init__(parent)
        self._titles = titles
        self.row = QWidget()  # Contains the buttons
        for number in range(len(titles)):
            button = tool_button("", "", checkable=True)
            font = button.font()
            font.setPointSize(SMALL)
            button.setFont(font)
            self.addButton(button, number)
        fill(QHBoxLayout(self.row), *self.buttons(), 1, margins=(0, 0, 0, 0), spacing=1)

    def show_states(self, states: Sequence[StepState]) -> None:
        colours = theme.of(self.row)
        colour = {StepState.DONE: colours.good, StepState.NEEDS_ATTENTION: colours.doubtful}
        named = zip(self._titles.items(), states, strict=True)
        for number, ((name, title), state) in enumerate(named):
            button = self.button(number)
            button.setText(f"{number + 1}{state.value}\n{name}")
            button.setToolTip(f"{title}: {state.name.replace('_', ' ').lower()}")
            own = QPalette()
            if state in colour:
                own.setColor(QPalette.ColorRole.ButtonText, QColor(colour[state]))
            button.setPalette(own)
