"""Monkey test of the window: random clicks, drags, keys and seeks from a seed."""

from __future__ import annotations

import faulthandler
import random
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from PySide6.QtCore import QPoint, QPointF, Qt, QTimer
from PySide6.QtGui import QWheelEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSlider,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QGraphicsView,
    QLabel,
    QMenu,
    QWidget,
)

from benchmarks.window.bench_window import bench_window
from benchmarks.window.memory_at_rest import Rest
from benchmarks.window.replay_rate import beats
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.upkeep import resident_mib
from bubbleviz_ui.window_session import WindowSession

REST_EVERY_S = 60.0  # interval of closing everything and measuring memory
MAX_GROWTH_MIB = 100.0  # of resident memory; chosen
POP_UP_MS = 100  # until a menu that was opened is closed
TIMEOUT_S = 150.0  # then the stacks of all threads are printed and the process ends
FORBIDDEN = (
    *("Quit", "Open", "Save", "Screenshot", "screenshot"),
    *("Export", "Import", "Record", "Turntable"),
)
"""Words of actions that would end the run or ask for a file."""
KEYS = "Left Right Up Down Space Home End Tab Backtab PageUp PageDown Escape Return Plus Minus 1 5"


@dataclass
class Report:
    """Results of a monkey run."""

    actions: int = 0
    seconds: float = 0.0
    rest_mib: list[float] = field(default_factory=list)  # with everything closed, over time
    most_mib: float = 0.0  # highest after an action
    longest_ms: float = 0.0  # longest time without events in the window's thread
    longest: str = ""  # the action at that time
    problems: list[str] = field(default_factory=list)  # tracebacks and messages

    @property
    def growth_mib(self) -> float:
        """Growth of memory with everything closed, from the first tour to the end; or NaN."""
        return self.rest_mib[-1] - self.rest_mib[0] if self.rest_mib else float("nan")

    @property
    def passed(self) -> bool:
        """Whether there was no exception, and no more memory than allowed."""
        return not self.problems and not self.growth_mib > MAX_GROWTH_MIB

    @property
    def measured(self) -> dict[str, float]:
        """The numbers by name."""
        return {
            "actions": float(self.actions),
            "seconds": self.seconds,
            "rest_mib": self.rest_mib[-1] if self.rest_mib else float("nan"),
            "growth_mib": self.growth_mib,
            "most_mib": self.most_mib,
            "longest_ms": self.longest_ms,
            "problems": float(len(self.problems)),
        }


def monkey_run(
    sensor: Sensor, recording: Path | None, seconds: float, seed: int, *, memory: bool = True
) -> Report:
    """Click and type at random in a window on a private screen; the targets depend on timing.

    If memory is compared everything is opened first, which takes up to a minute.
    """
    report = Report()
    with _caught(report), bench_window(sensor, recording) as session:
        session.wait_until_drawn()
        session.controller.failed.connect(
            lambda failed: report.problems.append(failed.details) if failed.details else None
        )
        monkey = Monkey(session, random.Random(seed), report)
        monkey.run(seconds, memory=memory)
    return report


class Monkey:
    """Performs random actions in a window."""

    def __init__(self, session: WindowSession, dice: random.Random, report: Report) -> None:
        self._session, self._dice, self._report = session, dice, report
        self._rest = Rest(session)
        self._things: tuple[tuple[float, Callable[[], None]], ...] = (
            (5.0, self._click),
            (3.0, self._key),
            (3.0, self._seek),
            (2.0, self._drag),
            (2.0, self._action),
            (1.0, self._wheel),
            (0.3, self._resize),
            (0.3, self._undo_all),
        )

    def run(self, seconds: float, *, memory: bool) -> None:
        """Run for some time; see `monkey_run`."""
        leave = QTimer(self._session.window)  # menus and dialogs run their own event loops
        leave.timeout.connect(lambda: self._leave_pop_ups())
        leave.start(POP_UP_MS)
        faulthandler.dump_traceback_later(seconds + TIMEOUT_S, exit=True)
        try:
            go_on = self._go_on_and_rest if memory else self._go_on
            go_on(seconds)
        finally:
            faulthandler.cancel_dump_traceback_later()
            leave.stop()

    def _go_on_and_rest(self, seconds: float) -> None:
        self._rest.tour()
        self._report.rest_mib.append(self._rest.memory_mib())
        rests = max(round(seconds / REST_EVERY_S), 1)
        for _ in range(rests):
            self._go_on(seconds / rests)
            self._report.rest_mib.append(self._rest.memory_mib())

    def _go_on(self, seconds: float) -> None:
        report, start = self._report, time.monotonic()
        weights = [weight for weight, _ in self._things]
        with beats() as gaps_ms:
            while time.monotonic() - start < seconds:
                [(_, thing)] = self._dice.choices(self._things, weights)
                gaps_ms.clear()
                try:
                    thing()
                except Exception:
                    report.problems.append(traceback.format_exc())
                self._session.application.processEvents()
                self._session.raise_if_interrupted()
                longest_ms = max(gaps_ms, default=0.0)
                if longest_ms > report.longest_ms:
                    report.longest_ms, report.longest = longest_ms, f"{thing.__name__} {self._at}"
                report.actions += 1
                report.most_mib = max(report.most_mib, resident_mib())
        report.seconds += time.monotonic() - start

    _at = ""

    def _click(self) -> None:
        widget = self._some_widget()
        if widget is not None:
            QTest.mouseClick(widget, Qt.MouseButton.LeftButton, pos=self._place(widget))

    def _drag(self) -> None:
        widget = self._some_widget()
        if widget is None:
            return
        left = Qt.MouseButton.LeftButton
        QTest.mousePress(widget, left, pos=self._place(widget))
        for _ in range(4):
            QTest.mouseMove(widget, self._place(widget))
        QTest.mouseRelease(widget, left, pos=self._place(widget))

    def _wheel(self) -> None:
        view = self._session.window.view
        place, turn = QPointF(self._place(view)), self._dice.choice((-120, 120))
        none = Qt.KeyboardModifier.NoModifier
        event = QWheelEvent(
            place, QPointF(view.mapToGlobal(place.toPoint())), QPoint(), QPoint(0, turn),
            Qt.MouseButton.NoButton, none, Qt.ScrollPhase.NoScrollPhase, False,
        )  # fmt: skip
        QApplication.sendEvent(view, event)

    def _key(self) -> None:
        name = self._dice.choice([*KEYS.split(), *"BEFLMNR"])
        modifier = self._dice.choice(
            [Qt.KeyboardModifier.NoModifier] * 4
            + [Qt.KeyboardModifier.ShiftModifier, Qt.KeyboardModifier.ControlModifier]
        )
        if modifier == Qt.KeyboardModifier.ControlModifier and name in "BEFLMNR":
            return  # may open a file dialog
        window = self._session.window
        QTest.keyClick(window.focusWidget() or window, getattr(Qt.Key, f"Key_{name}"), modifier)

    def _seek(self) -> None:
        state = self._session.state
        state.seek(self._dice.randrange(state.facts.frames))
        state.set_playing(self._dice.random() < 0.5)

    def _action(self) -> None:
        actions = self._session.window.shortcuts.actions
        name = self._dice.choice(sorted(actions))
        self._at = name
        if not _forbidden(name) and not _forbidden(actions[name].text()):
            actions[name].trigger()

    def _resize(self) -> None:
        self._session.window.resize(self._dice.randint(900, 1280), self._dice.randint(600, 800))

    def _undo_all(self) -> None:
        stack = self._session.window.undo_stack
        for _ in range(self._dice.randint(1, 12)):
            stack.undo() if self._dice.random() < 0.7 else stack.redo()

    def _some_widget(self) -> QWidget | None:
        """A visible control that does not ask for a file."""
        window = self._session.window
        kinds = (QAbstractButton, QAbstractSlider, QAbstractSpinBox, QComboBox, QGraphicsView)
        found: list[QWidget] = [
            widget
            for widget in window.findChildren(QWidget)
            if widget.isVisible() and widget.isEnabled() and isinstance(widget, kinds)
        ]
        found = [w for w in found if not _asks_for_a_file(w)]
        view: QWidget = window.view
        found += [view, view, view, window.playback.timeline, window.playback.timeline]
        found += [window.status, *window.status.findChildren(QLabel)[-3:]]
        chosen = self._dice.choice(found) if found else None
        self._at = f"{type(chosen).__name__} {chosen.toolTip() if chosen else ''}"
        return chosen

    def _place(self, widget: QWidget) -> QPoint:
        x = self._dice.randint(0, max(widget.width() - 1, 0))
        return QPoint(x, self._dice.randint(0, max(widget.height() - 1, 0)))

    def _leave_pop_ups(self) -> None:
        """Close pop-ups, so that the window is never locked; trigger an action of a menu."""
        application = self._session.application
        popup = application.activePopupWidget() or application.activeModalWidget()
        if popup is None:
            return
        if isinstance(popup, QMenu):
            allowed = [a for a in popup.actions() if a.isEnabled() and not _forbidden(a.text())]
            if allowed:
                self._dice.choice(allowed).trigger()
        popup.close()


def _asks_for_a_file(widget: QWidget) -> bool:
    return isinstance(widget, QAbstractButton) and _forbidden(widget.text())


def _forbidden(text: str) -> bool:
    return "…" in text or any(word in text.replace("&", "") for word in FORBIDDEN)


@contextmanager
def _caught(report: Report) -> Iterator[None]:
    """Collect exceptions in slots, which Qt only prints."""
    before = sys.excepthook

    def note(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        report.problems.append("".join(traceback.format_exception(kind, error, trace)))

    sys.excepthook = note
    try:
        yield
    finally:
        sys.excepthook = before
