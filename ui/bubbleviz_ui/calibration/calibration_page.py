"""What the steps of the γ0 panel have in common."""

from __future__ import annotations

from PySide6.QtWidgets import QFormLayout, QLabel, QVBoxLayout, QWidget

from bubbleviz_ui.calibration.calibration_answer import Answer
from bubbleviz_ui.calibration.calibration_session import Calibration
from bubbleviz_ui.model.units import NOTHING, Units


class Page(QWidget):
    """One step: its picture, its numbers and what can be changed.

    Attributes
    ----------
    name, title : str
        On its button, and in full.
    todo : str
        What to do here, in one sentence.
    sets : tuple of str
        Settings that are changed here.
    next_title : str
        What the button that leads on to this page says.
    """

    name = ""
    title = ""
    todo = ""
    sets: tuple[str, ...] = ()
    next_title = ""

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__()
        self.calibration, self.units = calibration, units
        self.column = QVBoxLayout(self)
        self.column.setContentsMargins(0, 0, 0, 0)
        self.column.setSpacing(6)

    def enter(self) -> None:
        """The person goes on to this step: do what is not done yet."""

    def is_done(self, answer: Answer) -> bool:
        """Whether an answer has what this step is for."""
        raise NotImplementedError

    def show_answer(self, answer: Answer) -> None:
        """Show what is known."""
        raise NotImplementedError


class Numbers(QWidget):
    """Names and numbers, one under the other."""

    def __init__(self) -> None:
        super().__init__()
        self._form = QFormLayout(self)
        self._form.setContentsMargins(0, 0, 0, 0)
        self._form.setHorizontalSpacing(14)
        self._form.setVerticalSpacing(2)
        self._labels: dict[str, QLabel] = {}

    def set(self, name: str, text: str | None) -> None:
        """Write a number; None: a dash."""
        if name not in self._labels:
            label = QLabel()
            label.setObjectName("value")
            label.setWordWrap(True)
            self._labels[name] = label
            self._form.addRow(name, label)
        self._labels[name].setText(NOTHING if text is None else text)

    def text(self, name: str) -> str:
        """What is written for a name."""
        return self._labels[name].text()
