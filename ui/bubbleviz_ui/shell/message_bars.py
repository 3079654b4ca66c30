"""Bars above the view: what went wrong, what one waits for, how to begin; and what went well."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from pathlib import Path

from PySide6.QtCore import QSize, Qt, QTimer, Signal
from PySide6.QtWidgets import (
    QApplication,
    QButtonGroup,
    QFrame,
    QHBoxLayout,
    QLabel,
    QMenuBar,
    QProgressBar,
    QPushButton,
    QToolButton,
    QWidget,
)

from bubbleviz_ui.model.messages import UserMessage
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import BarLayout, Elided, fill

SHOWN_AFTER_MS = 400
"""What is done sooner needs no bar."""
NOTICE_MS = 6000
"""Long enough to read a path and to reach a button."""
GAP = 16
"""Between the menus and a notice, screen pixels."""
HINT = (
    "Welcome. Drop a recording here or press Ctrl+O; Space plays, ← → go frame by frame. "
    "Ctrl+K finds everything else; hold the mouse over a control to see what it does."
)


class _Bar(QFrame):
    """A line of text with buttons; hidden while there is nothing to say."""

    def __init__(self, parent: QWidget, name: str, *widgets: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName(name)
        self.kind, self.label = QLabel(), QLabel(wordWrap=True)
        self.kind.setObjectName("value")
        text = QWidget()
        fill(QHBoxLayout(text), self.kind, (self.label, 1), margins=(0, 0, 0, 0))
        BarLayout(self, text, *widgets, margins=(12, 6, 8, 6))
        self.kind.hide()
        self.hide()


class MessageBar(_Bar):
    """Warnings and errors, which stay until they are dismissed: errors first, then the newest."""

    asked = Signal()  # The user wants to read all messages

    def __init__(self, parent: QWidget) -> None:
        self._open: list[UserMessage] = []
        self.more = QPushButton()
        self.more.setToolTip("All messages of this session")
        self.copy = QPushButton("Copy details")
        self.copy.setToolTip("For a bug report: what went wrong, and where")
        self.dismiss = QPushButton("Dismiss")
        self.dismiss.setToolTip("Next message; Help → Messages lists all")
        super().__init__(parent, "warning", self.more, self.copy, self.dismiss)
        self.kind.show()
        self.more.clicked.connect(self.asked)
        self.copy.clicked.connect(
            lambda: QApplication.clipboard().setText("\n".join(m.report() for m in self._open))
        )
        self.dismiss.clicked.connect(lambda: self._keep(lambda message: message is not self._shown))

    def show_message(self, message: UserMessage) -> None:
        """Show a message; one that is told again counts once."""
        same = (message.kind, message.text)
        self._open = [other for other in self._open if (other.kind, other.text) != same]
        self._open.append(message)
        self._show_open()

    def drop_warnings(self) -> None:
        """Remove warnings: the source they are about is closed."""
        self._keep(lambda message: message.kind == "error")

    def drop_topic(self, topic: str) -> None:
        """Remove what went wrong with something that has succeeded since."""
        self._keep(lambda message: message.topic != topic)

    @property
    def _shown(self) -> UserMessage:
        errors = [message for message in self._open if message.kind == "error"]
        return (errors or self._open)[-1]

    def _keep(self, wanted: Callable[[UserMessage], bool]) -> None:
        """Remove all other messages."""
        self._open = [message for message in self._open if wanted(message)]
        self._show_open()

    def _show_open(self) -> None:
        self.setVisible(bool(self._open))
        if not self._open:
            return
        shown = self._shown
        self.setObjectName(shown.kind)
        self.style().polish(self)  # the style sheet goes by the name
        self.kind.setText(shown.kind.capitalize())
        self.label.setText(shown.text)
        self.more.setText(f"{len(self._open) - 1} more…")
        self.more.setVisible(len(self._open) > 1)
        self.copy.setVisible(any(message.details for message in self._open))


class NoticeBar(QFrame):
    """What went well, for some seconds; with the file that was written.

    It takes what the menus leave of their bar, so that nothing below moves.
    """

    asked = Signal(object)  # The user wants to open a file: its path

    def __init__(self, bar: QMenuBar) -> None:
        super().__init__(bar)
        self.setObjectName("notice")
        self._bar, self._room = bar, QSize()
        self._file: Path | None = None
        self.label = Elided(Qt.TextElideMode.ElideMiddle)  # a path's ends say most
        self.open = _button("Open", "Open the file here, or in the desktop's program for its kind")
        self.folder = _button("Show in folder", "Open the folder it is in")
        self.dismiss = _button("Dismiss", "Close; Help → Messages lists all")
        buttons = self.open, self.folder, self.dismiss
        fill(QHBoxLayout(self), (self.label, 1), *buttons, margins=(8, 0, 4, 0), spacing=2)
        self._due = QTimer(self, interval=NOTICE_MS)
        self._due.timeout.connect(self._leave)
        self.open.clicked.connect(lambda: self.asked.emit(self._file))
        self.folder.clicked.connect(lambda: self.asked.emit(self._file and self._file.parent))
        self.dismiss.clicked.connect(self.hide)
        self.hide()
        bar.setCornerWidget(self)

    def sizeHint(self) -> QSize:
        """No wider than what the menus leave, and no higher than they are."""
        return super().sizeHint().boundedTo(self._room)

    def minimumSizeHint(self) -> QSize:
        """It is as large as it asks to be."""
        return self.sizeHint()

    def show_message(self, message: UserMessage) -> None:
        """Show a message in place of the one before."""
        self.label.setText(message.text)
        self.label.setToolTip(message.text)
        self._file = None if message.file is None else message.file.absolute()
        for button in (self.open, self.folder):
            button.setVisible(self._file is not None)
        self._due.start()
        self.hide()
        menus = self._bar.actionGeometry(self._bar.actions()[-1])
        self._room = QSize(self._bar.width() - menus.right() - GAP, menus.height())
        self.show()

    def _leave(self) -> None:
        if not self.underMouse():  # somebody is about to click
            self._due.stop()
            self.hide()


def _button(text: str, tip: str) -> QToolButton:
    button = QToolButton()
    button.setText(text)
    button.setToolTip(tip)
    button.setAutoRaise(True)
    return button


class BusyBar(_Bar):
    """What is being opened or closed, once it takes a while."""

    def __init__(self, parent: QWidget) -> None:
        self.progress = QProgressBar(minimum=0, maximum=0)
        self.progress.setFixedWidth(160)
        self.cancel = QPushButton("Cancel")
        self.cancel.setToolTip("The current source stays open")
        super().__init__(parent, "busy", self.progress, self.cancel)
        self._due = QTimer(self, singleShot=True, interval=SHOWN_AFTER_MS)
        self._due.timeout.connect(self.show)

    def wait_for(self, what: str) -> None:
        """Say what is being done, unless it is over soon; nothing: it is over."""
        self.label.setText(what)
        if what and not self.isVisible():
            self._due.start()
        elif not what:
            self._due.stop()
            self.hide()


class HintBar(_Bar):
    """What a new user should know, once."""

    def __init__(self, parent: QWidget) -> None:
        self.understood = QPushButton("Got it")
        super().__init__(parent, "hint", self.understood)
        self.label.setText(HINT)
        self.understood.clicked.connect(self.hide)


# Steps in a row: number, name, and how far each is.


SMALL = "font-size: 8pt;"
"""Seven names have room in a panel of 380 pixels."""


class StepState(Enum):
    """How far a step is; its value is the mark on its button."""

    TO_DO = ""
    DONE = " ✓"
    NEEDS_ATTENTION = " !"

    @property
    def words(self) -> str:
        """For people."""
        return self.name.replace("_", " ").lower()


class StepButtons(QButtonGroup):
    """A button for each step; one is checked.

    `titles`: In full, by the name on the button.
    """

    def __init__(self, parent: QWidget, titles: Mapping[str, str]) -> None:
        super().__init__(parent)
        self._titles = titles
        self.row = QWidget()  # Has the buttons
        for number in range(len(titles)):
            button = QToolButton()
            button.setCheckable(True)
            button.setObjectName("slim")
            self.addButton(button, number)
        fill(QHBoxLayout(self.row), *self.buttons(), 1, margins=(0, 0, 0, 0), spacing=1)

    def show_states(self, states: Sequence[StepState]) -> None:
        """Say of each step how far it is."""
        colours = theme.of(self.row)
        colour = {StepState.DONE: colours.good, StepState.NEEDS_ATTENTION: colours.doubtful}
        named = zip(self._titles.items(), states, strict=True)
        for number, ((name, title), state) in enumerate(named):
            button = self.button(number)
            button.setText(f"{number + 1}{state.value}\n{name}")
            button.setToolTip(f"{title}: {state.words}")
            own = state in colour and not button.isChecked()
            button.setStyleSheet(SMALL + (f" color: {colour[state]};" if own else ""))
