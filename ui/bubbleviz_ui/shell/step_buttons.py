"""Steps in a row: number, name, and how far each is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum

from PySide6.QtWidgets import QButtonGroup, QHBoxLayout, QToolButton, QWidget

from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.layouts import fill

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

    Parameters
    ----------
    parent : QWidget
    titles : mapping
        In full, by the name on the button.

    Attributes
    ----------
    row : QWidget
        Has the buttons.
    """

    def __init__(self, parent: QWidget, titles: Mapping[str, str]) -> None:
        super().__init__(parent)
        self._titles = titles
        self.row = QWidget()
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
