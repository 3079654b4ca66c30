"""The calibration panel: pages of the steps, verdict, progress."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from PySide6.QtCore import QEvent
from PySide6.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QProgressDialog,
    QStackedWidget,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.calibration import Identification, Step, grade, headline
from bubbleviz.progress import Progress
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz_ui.calibration.calibration_page import Page
from bubbleviz_ui.calibration.calibration_session import Calibration
from bubbleviz_ui.calibration.frames_page import FramesPage
from bubbleviz_ui.calibration.levels_page import RectificationPage
from bubbleviz_ui.calibration.pixels_page import PixelsPage, SurfacePage, TensionPage
from bubbleviz_ui.calibration.report_page import ReportPage, ValidationPage
from bubbleviz_ui.engine.solver import OpenRequest
from bubbleviz_ui.model.messages import CALIBRATION
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import fill, push_button, scrolled
from bubbleviz_ui.shell.file_dialogs import ask_to_save, name_of_output, new_file, remember_sensor
from bubbleviz_ui.shell.message_bars import JobProgress, StepButtons, StepState

OUTDATED = "Outdated: settings changed since."
WIDTH, LEAST_HEIGHT = 380, 40
"""Of the panel, and of a page on a low screen, where it is scrolled, screen pixels."""


class CalibrationPanel(QWidget):
    """Step buttons, the page of one step, verdict, progress."""

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__()
        self.calibration, self.units = calibration, units
        self._folders: list[TemporaryDirectory[str]] = []
        self._make_pages()
        self.steps = StepButtons(self, {page.name: page.title for page in self.pages})
        self._unsaved_sensor: Sensor | None = None  # identified sensor in use before it is saved
        self._saved_file: Path | None = None  # of the identification saved last
        self.verdict = QLabel(wordWrap=True)
        self.back = push_button(
            "Back", "Previous step", lambda: self.go_to(self.stack.currentIndex() - 1)
        )
        self.next = push_button(
            "", "Compute the step named here if needed, and show it", self._on_next
        )
        self.all = push_button(
            "Identify",
            "Compute all steps up to γ0",
            partial(calibration.reach, Step.TENSION, "Identify"),
        )
        self.use = push_button(
            "Use now",
            "Use the new sensor for the current source; undo restores the old one",
            self.use_sensor,
        )
        self.save_as = push_button(
            "Save sensor as…",
            "Write sensor file, mesh, pixel data and report, or nothing if one fails",
            self._choose_file,
        )
        self.progress = JobProgress()
        self.cancel = push_button(
            "Cancel", "Stop, and go back to the settings of the results shown", calibration.cancel
        )
        self._lay_out()
        self._connect()
        self.go_to(0)

    @property
    def boxes(self) -> dict[str, QWidget]:
        """Controls that do not affect the sensor file, by their name in the Edit menu."""
        collect = self.frames.collect
        return {
            "picture": self.pixels.picture,
            "frames to collect": collect.count,
            "frames with contact": collect.contact_free,
        }

    @property
    def page(self) -> Page:
        return self.pages[self.stack.currentIndex()]

    def go_to(self, number: int) -> None:
        self.stack.setCurrentIndex(number)
        self.steps.button(number).setChecked(True)
        self._show()

    def save(self, path: Path) -> None:
        """Write sensor file, mesh, pixels and report in the calibration thread."""
        answer, initial = self.calibration.answer, self.calibration.initial_sensor
        work, found, source = answer.work, answer.found, answer.source
        if not found.complete or source is None or initial is None:
            return
        report = path.with_name(f"{path.stem}_report")
        named = replace(found, given=found.given.model_copy(update={"name": path.stem}))

        def job(progress: Progress) -> None:
            from bubbleviz.calibration import write_sensor  # not at start

            write_sensor(
                named, path, report, source=source, sensor_file=initial.name, progress=progress
            )

        saved = f"Saved {path} and {report.name}"

        def on_saved(_: None) -> None:
            self.calibration.saved, self._saved_file = work, path
            remember_sensor(path, (named.sensor.camera.width, named.sensor.camera.height))
            controller = self.calibration.controller
            controller.state.messages.add("notice", saved, file=path, topic=CALIBRATION)
            if self._unsaved_sensor is not None and controller.sensor is self._unsaved_sensor:
                controller.opening.open_sensor_file(path)  # replaces the unsaved sensor

        self.calibration.start(job, on_saved)

    def confirm_close(self) -> bool:
        """Ask about an unsaved identification; returns whether closing may continue."""
        if not self.calibration.unsaved:
            return True
        text = f"The sensor identified from {self.calibration.name} is not saved."
        choice = ask_to_save(self, "Calibration", text)
        return choice == "discard" or (choice == "save" and self._save_now())

    def use_sensor(self) -> None:
        """Use the identified sensor with the current source; undo restores the previous one."""
        found, present = self.calibration.answer.found, self.calibration.controller.sensor
        if not found.complete or present is None:
            return
        saved = None if self.calibration.unsaved else self._saved_file
        if saved is not None and saved.is_file():  # not deleted since
            new = load_sensor(saved)
        else:
            new = self._write_unsaved(found)
        open_sensor = self.calibration.controller.opening.use_sensor
        self.calibration.undo.push("Use the new sensor", open_sensor, present, new)

    def _write_unsaved(self, found: Identification) -> Sensor:
        """The identified sensor in a temporary file, which is hidden from the user."""
        folder = TemporaryDirectory(prefix="bubbleviz-")
        self._folders.append(folder)  # the sensor reads its files again when reopened
        path = Path(folder.name) / "sensor.toml"
        from bubbleviz.calibration import write_sensor  # not at start

        write_sensor(found, path)
        named = {"name": f"{found.sensor.name}, identified", "file": ""}
        self._unsaved_sensor = load_sensor(path).model_copy(update=named)
        return self._unsaved_sensor

    def remove_files(self) -> None:
        """Remove temporary files, once no thread reads them."""
        for folder in self._folders:
            folder.cleanup()

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange and self.layout() is not None:
            self._show()

    def _make_pages(self) -> None:
        calibration, units = self.calibration, self.units
        self.frames = FramesPage(calibration, units)
        self.pixels = PixelsPage(calibration, units)
        self.surface = SurfacePage(calibration, units)
        self.tension = TensionPage(calibration, units)
        self.rectification = RectificationPage(calibration, units)
        self.validation = ValidationPage(calibration, units)
        self.report = ReportPage(calibration, units)
        self.pages: list[Page] = [
            self.frames,
            self.pixels,
            self.surface,
            self.tension,
            self.rectification,
            self.validation,
            self.report,
        ]

    def _connect(self) -> None:
        calibration = self.calibration
        self.steps.idClicked.connect(self.go_to)
        calibration.changed.connect(self._show)
        calibration.restarted.connect(self._begin_anew)
        calibration.progressed.connect(self.progress.show_step)
        calibration.controller.opening.about_to_open.connect(self._on_about_to_open)

    def _on_next(self) -> None:
        """Go to the next page and compute its step; on the first page, first compute its own.

        After a failure, compute the step that failed again.
        """
        if self.calibration.failed:
            self.calibration.repeat()
            return
        if not isinstance(self.page, FramesPage) or self.calibration.settings.last_step:
            self.go_to(self.stack.currentIndex() + 1)
        self.page.enter()

    def _begin_anew(self) -> None:
        self.go_to(0)

    def _on_about_to_open(self, request: OpenRequest) -> None:
        """Ask before opening a source that would discard an unsaved identification."""
        if self.calibration.would_lose_work(request) and not self.confirm_close():
            request.cancelled.set()

    def _choose_file(self) -> None:
        proposed = name_of_output(self.calibration.name, f"{time.strftime('%Y-%m-%d')}.toml")
        kinds = "Sensor files (*.toml)"
        path, _ = new_file(self, "Save sensor as", proposed, kinds, of="sensor")
        if path is not None:
            self.save(path)

    def _save_now(self) -> bool:
        """Ask for a name and save the identification; returns whether it was saved."""
        calibration = self.calibration
        self._choose_file()
        waiting = QProgressDialog("Writing sensor file and report…", "Cancel", 0, 0, self)
        waiting.setWindowTitle("Calibration")
        waiting.canceled.connect(calibration.cancel)
        calibration.changed.connect(waiting.accept)
        while calibration.busy:
            waiting.exec()
        calibration.changed.disconnect(waiting.accept)
        waiting.deleteLater()
        return not calibration.unsaved

    def _show(self) -> None:
        calibration, page = self.calibration, self.page
        answer, busy = calibration.answer, calibration.busy
        page.show_answer(answer)
        place, reached = self.stack.currentIndex(), calibration.settings.last_step
        started = reached > Step.START
        needs_collecting = calibration.live and calibration.work.collected is None
        following = self.pages[min(place + 1, len(self.pages) - 1)]
        self.next.setVisible(page is not self.report)
        ready = answer.comparison is not None and not busy and not calibration.outdated
        for button in (self.use, self.save_as):
            button.setVisible(page is self.report)
            button.setEnabled(ready)
        computed = following.is_done(answer) and not calibration.outdated
        to_do = following.next_title if started else self.frames.next_title
        if calibration.failed:
            to_do = "Try again"
        self.next.setText(f"Next: {following.title}" if computed else to_do)
        self.next.setEnabled(not needs_collecting and page is not self.report)
        self.back.setEnabled(place > 0)
        self.all.setVisible(reached < Step.TENSION)
        self.all.setEnabled(not needs_collecting)
        if busy and not self.progress.isVisible():
            self.progress.show_step("starting", 0.0)
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        known = self._reachable_pages()
        for number in range(len(self.pages)):
            self.steps.button(number).setEnabled(number == place or number < known)
        self.steps.show_states([self._state(number) for number in range(len(self.pages))])
        found, outdated = answer.found, calibration.outdated
        self.verdict.setVisible(found.complete)
        if found.complete:
            colour = getattr(theme.of(self), "doubtful" if outdated else grade(found))
            line = headline(found, self.units.gas_pressure.text)
            self.verdict.setText(f"{OUTDATED} {line}" if outdated else line)
            self.verdict.setStyleSheet(f"color: {colour}")

    def _state(self, number: int) -> StepState:
        """State of a step; failed and doubtful ones need attention."""
        answer, page = self.calibration.answer, self.pages[number]
        changed = self._first_outdated_step()
        refused = self.calibration.failed and number == changed
        doubtful = answer.found.complete and grade(answer.found) == "doubtful"
        press = answer.found.validation
        failed = press is not None and bool(press.failures)
        if refused or (doubtful and page is self.tension) or (failed and page is self.validation):
            return StepState.NEEDS_ATTENTION
        outdated = self.calibration.outdated and number >= changed
        return StepState.DONE if page.is_done(answer) and not outdated else StepState.TO_DO

    def _first_outdated_step(self) -> int:
        """The first step whose settings changed since the results shown, else the first to do."""
        work, shown = self.calibration.work, self.calibration.answer.work
        if work.collected is not shown.collected:
            return 0
        for number, page in enumerate(self.pages):
            if any(
                getattr(work.settings, name) != getattr(shown.settings, name) for name in page.sets
            ):
                return number
        return min(int(shown.settings.last_step), len(self.pages) - 1)

    def _reachable_pages(self) -> int:
        reached = self.calibration.answer.work.settings.last_step
        return len(self.pages) if reached >= Step.TENSION else max(1, int(reached))

    def _lay_out(self) -> None:
        self.setMinimumWidth(WIDTH)
        column = QVBoxLayout(self)
        column.setContentsMargins(12, 8, 12, 10)
        self.stack = QStackedWidget()
        for page in self.pages:
            area = scrolled(page)
            area.setMinimumHeight(LEAST_HEIGHT)
            self.stack.addWidget(area)
        self.next.setDefault(True)
        self.save_as.setDefault(True)
        self.verdict.hide()
        working = fill(QHBoxLayout(), (self.progress, 1), self.cancel)
        last = (self.next, 1), self.use, (self.save_as, 1)
        buttons = fill(QHBoxLayout(), self.back, self.all, *last)
        parts = (self.steps.row, (self.stack, 1), self.verdict)
        fill(column, *parts, working, buttons)
