"""Compare panel: two settings on the current frame; the open recording with another one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.errors import InputError
from bubbleviz.output import ComparedResult
from bubbleviz.pipeline import FrameOptions
from bubbleviz.progress import part_of
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver import ComparedOptions
from bubbleviz_ui.engine.source import RECORDINGS, Source
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import COMPARED_NAMES, PATCH_SETTINGS, ComparedSetting
from bubbleviz_ui.model.source_facts import STATUS, force_text, friction_text
from bubbleviz_ui.model.units import DASH, Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.binding import bind_membership, control, options
from bubbleviz_ui.shell.dock import fill, push_button
from bubbleviz_ui.shell.file_dialogs import SENSOR_FILES, file_to_open

if TYPE_CHECKING:
    from bubbleviz.api.results import Run
    from bubbleviz_ui.panels.other_recording import AlignedRun

NOT_MEASURED = None, None
SOLVING = "solving …"
NEEDS_TRUTH = "Force error and patch IoU need the ground truth of a simulation."
DEPTH_ALONE = "This panel solves by depth alone; the frame shown uses its colour image, too."
ROWS: dict[str, tuple[str, Callable[[ComparedResult, Units], str]]] = {
    "frame": ("Frame", lambda m, u: f"{m.result.frame.index}"),
    "solver": ("Model", lambda m, u: m.solver),
    "status": ("Status", lambda m, u: STATUS[m.numbers.status]),
    "force": ("Force", lambda m, u: force_text(m.result, u)),
    "friction": ("Friction", lambda m, u: friction_text(m.result, u)),
    "area": ("Patch area", lambda m, u: u.area.text(m.numbers.area_m2)),
    "residual": ("Residual", lambda m, u: u.fine_length.text(m.numbers.residual_m)),
    "force_error": ("Force error", lambda m, u: u.share.text(m.force_error)),
    "iou": ("Patch IoU", lambda m, u: DASH if math.isnan(m.iou) else f"{m.iou:.2f}"),
    "total": ("Total time", lambda m, u: u.duration.text(m.numbers.total_ms)),
    "solve": ("Solver time", lambda m, u: u.duration.text(m.numbers.solve_ms)),
    "nodes": ("Nodes used", lambda m, u: f"{len(m.mesh.nodes)}"),
}
"""Measured quantities: title, and text of the value."""
STATISTICS = {"median": "median", "p95": "95th percentile", "max": "maximum"}
"""Words for the statistics of a `Comparison`."""


class SettingColumn:
    """One of the two settings: its controls, and a column with its results for the frame."""

    def __init__(self, state: SessionState, number: int) -> None:
        self._state, self._number = state, number
        self.controls = {each.name: self._control(each.name) for each in fields(ComparedSetting)}
        tip = "Use this setting in the whole window; Ctrl+Z restores the previous one"
        self.used = push_button(f"Use {COMPARED_NAMES[number]}", tip, self.use)
        self.values = {name: QLabel(DASH) for name in ROWS}
        for label in self.values.values():
            theme.bold(label)
        self.title = QLabel(COMPARED_NAMES[number])
        colours = f"background: {theme.COMPARED[number]}; color: {theme.ON_BADGE}"
        self.title.setStyleSheet(f"{colours}; padding: 1px 5px")
        self.title.setToolTip("Its patch outline in the 3-D view has this colour")

    def _control(self, name: str) -> Any:
        """Control of the field of that name."""

        def inside(settings: tuple[ComparedSetting, ...]) -> Any:
            return getattr(settings[self._number], name)

        def around(value: Any) -> tuple[ComparedSetting, ...]:
            settings = list(self._state.settings.compared)
            settings[self._number] = replace(settings[self._number], **{name: value})
            return tuple(settings)

        return control(self._state, "compared", ComparedSetting.info(name), inside, around)

    @property
    def setting(self) -> ComparedSetting:
        return self._state.settings.compared[self._number]

    def use(self) -> None:
        """Apply this setting to the whole window."""
        kappa = self.setting.kappa
        rule = {} if kappa is None else {"kappa": kappa}
        self._state.change(solver=COMPARED_NAMES[self._number], **rule)

    def show_measured(
        self, measured: ComparedResult | str | None, units: Units, waiting: str
    ) -> None:
        """Show the numbers, or a text that says why there are none; None: status `waiting`."""
        for name, (_, text) in ROWS.items():
            shown = text(measured, units) if isinstance(measured, ComparedResult) else DASH
            self.values[name].setText(shown)
        if not isinstance(measured, ComparedResult):
            self.values["status"].setText(waiting if measured is None else "impossible")
        self.values["status"].setToolTip(measured if isinstance(measured, str) else "")


class OtherRecording(QWidget):
    """Controls of another recording or sensor file, and the differences of its results.

    Both runs are solved in a separate thread, with the settings of the window.
    """

    aligned = Signal(object)  # An `AlignedRun` whose curves are drawn, or None
    membrane = Signal(object)  # The same, if its membrane is drawn as well

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self._state, self._controller = state, controller
        self.worker = Worker("compare")
        self._recording: Path | None = None
        self._sensor_file: Path | None = None
        self._solved_options = self._current_options
        self._runs: tuple[Run, Run] | None = None
        self._aligned: AlignedRun | None = None
        self.recording = push_button(
            "", "Recording to compare with the one that is open", self._choose_recording
        )
        self.sensor_file = push_button(
            "",
            "Sensor file of the other recording; without another recording: solve the open one "
            "also with this file",
            self._choose_sensor,
        )
        ways = {"time": "By time", "contact": "By first contact"}
        self.align = options(QComboBox(), ways)
        self.start = push_button(
            "Compare",
            "Solve all frames of the open recording and of the comparison chosen above, with the "
            "settings of the window",
            self._start,
        )
        self.remove = push_button(
            "Remove", "Remove the other recording and sensor file from the comparison", self._forget
        )
        self.drawn = QCheckBox("Second membrane")
        self.result = QLabel(wordWrap=True)
        self._lay_out()
        self._forget()
        self.align.currentIndexChanged.connect(self._align)
        self.drawn.toggled.connect(self._draw_membrane)
        self.worker.progressed.connect(self._show_progress)
        state.source_changed.connect(self._drop)
        state.frame_changed.connect(self._write)
        state.settings_changed.connect(self._on_settings)

    def _lay_out(self) -> None:
        self.align.setAccessibleName("Alignment")
        self.align.setToolTip(
            "Align the recordings by the time since their start, or since first contact"
        )
        self.drawn.setToolTip(
            "After comparing, draw the other membrane next to that of the open recording, at the "
            "same time"
        )
        theme.bold(self.result)
        choices = fill(QHBoxLayout(), (self.recording, 1), (self.sensor_file, 1))
        actions = fill(QHBoxLayout(), (self.align, 1), self.start, self.remove)
        title = QLabel("Another recording or sensor file")
        fill(
            QVBoxLayout(self), title, choices, actions, self.drawn, self.result,
            margins=(0, 8, 0, 0), spacing=3,
        )  # fmt: skip

    def _choose_recording(self) -> None:
        self._recording = file_to_open(self, "Compare with", RECORDINGS, of="recording")
        self._drop()

    def _choose_sensor(self) -> None:
        self._sensor_file = file_to_open(self, "Sensor file", SENSOR_FILES, of="sensor")
        self._drop()

    def _forget(self) -> None:
        self._recording = self._sensor_file = None
        self._drop()

    def _on_settings(self, _: object) -> None:
        if (self._runs or self.worker.busy) and self._current_options != self._solved_options:
            self._drop()
        self._write()  # in the operator's units

    def _drop(self, _: object = None) -> None:
        """Discard the results; the chosen files stay."""
        self.worker.cancel()
        self._runs = None
        for button, path, title in (
            (self.recording, self._recording, "Recording…"),
            (self.sensor_file, self._sensor_file, "Sensor file…"),
        ):
            button.setText(title if path is None else path.name)
        facts = self._state.facts
        possible = not (facts.is_empty or facts.grows)
        chosen = self._recording is not None or self._sensor_file is not None
        self.start.setEnabled(possible and chosen)
        self.remove.setEnabled(chosen)
        self.result.clear()
        self._take(None)

    @property
    def _current_options(self) -> ComparedOptions:
        """Options of estimate and patch that the window uses."""
        return self._state.settings.options, FrameOptions(*self._state.settings.patch_rule)

    def _start(self) -> None:
        # not at start: it is needed for the first comparison
        from bubbleviz_ui.panels.other_recording import solve

        source, sensor = self._controller.opening.source, self._controller.sensor
        if source is None or sensor is None:
            return
        path = self._recording
        other = source if path is None else Source.of_recording(path)
        open_other = self._controller.opening.sensor_of(path, self._sensor_file)
        options = self._solved_options = self._current_options
        half = partial(part_of, self.worker.progress)
        first = partial(solve, source, lambda: sensor, *options, half(0.0, 0.5), keep=False)
        second = partial(solve, other, open_other, *options, half(0.5, 1.0), keep=True)
        self.start.setEnabled(False)
        self.result.setText("opening …")
        self.worker.submit(lambda: (first(), second()), self._on_solved, self._on_failed)

    def _show_progress(self, title: str, done: float) -> None:
        self.result.setText(f"solving {title}: {100 * done:.0f} %")

    def _on_solved(self, runs: tuple[Run, Run]) -> None:
        self.start.setEnabled(True)
        self._runs = runs
        self._align()

    def _on_failed(self, failed: Failed) -> None:
        self.start.setEnabled(True)
        self.result.setText(failed.message)

    def _align(self, _: object = None) -> None:
        from bubbleviz_ui.panels.other_recording import AlignedRun  # as in `_start`

        if self._runs is None:
            return
        try:
            self._take(AlignedRun.of(*self._runs, self.align.currentData()))
        except InputError as error:
            self._take(None)
            self.result.setText(str(error))

    def _take(self, aligned: AlignedRun | None) -> None:
        self._aligned = aligned
        self.drawn.setEnabled(aligned is not None)
        self.aligned.emit(aligned)
        self._draw_membrane()
        self._write()

    def _draw_membrane(self, _: object = None) -> None:
        self.membrane.emit(self._aligned if self.drawn.isChecked() else None)

    def _write(self, *_: object) -> None:
        """Show the differences over all frames, and in the frame at the cursor."""
        if self._aligned is None:
            return
        found, units, k = self._aligned.found, self._state.units, self._state.frame
        facts = self._aligned.facts
        shift = units.time.text(-found.shift_s, signed=True)
        lines = [f"{found.other}: dashed in Plots, its times shifted by {shift}"]
        for title, unit, name, here in (
            ("|ΔF|", units.force, "force_difference_n", found.force_difference_n[k]),
            ("|Δarea|", units.area, "area_difference_m2", abs(found.area_difference_m2[k])),
        ):
            sizes = [
                f"{unit.text(facts[f'{key}_{name}'])} {word}" for key, word in STATISTICS.items()
            ]
            of_all = f"over frames with contact {', '.join(sizes)}"
            lines.append(f"{title} in this frame {unit.text(here)}; {of_all}")
        self.result.setText("\n".join(lines))


class ComparePanel(QWidget):
    """Two settings A and B; measures again whenever the frame or a setting changes.

    The solver thread measures them when no frame is being waited for.
    """

    # Results of A and of B: each a `ComparedResult`, or anything else for none
    measured = Signal(object)

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self._state, self._controller = state, controller
        self._measured: tuple[ComparedResult | str | None, ...] = NOT_MEASURED
        self.a, self.b = SettingColumn(state, 0), SettingColumn(state, 1)
        self.outlines = QCheckBox("Outlines in the 3-D view")
        self.outlines.setToolTip("Draw the patch outlines of A and B in their colours")
        bind_membership(self.outlines, state, "layers", "compared")
        self.other = OtherRecording(state, controller)
        self._lay_out()
        controller.compared.connect(self._on_compared)
        controller.failed.connect(self._on_failed)
        state.frame_changed.connect(self._on_frame)
        state.source_changed.connect(self._ask_anew)
        state.playing_changed.connect(self._ask)
        state.frozen_changed.connect(self._ask)
        state.settings_changed.connect(self._on_settings)

    def _lay_out(self) -> None:
        grid = QGridLayout()
        grid.setHorizontalSpacing(8)
        grid.setVerticalSpacing(2)
        for place, each in enumerate((self.a, self.b), start=1):
            grid.addWidget(each.title, 0, place)
        a, b = self.a, self.b
        rows = [("", a.title, b.title)]  # results first: on a low screen the rest is scrolled
        rows += ((title, a.values[name], b.values[name]) for name, (title, _) in ROWS.items())
        controls = zip(a.controls.values(), b.controls.values(), strict=True)
        rows += ((of_a.accessibleName(), of_a, of_b) for of_a, of_b in controls)
        for row, (title, *both) in enumerate([*rows, ("", a.used, b.used)]):
            grid.addWidget(QLabel(title), row, 0)
            for place, widget in enumerate(both, start=1):
                grid.addWidget(widget, row, place)
        for each in (a, b):
            for widget in (*each.controls.values(), each.used):
                widget.setMinimumWidth(94)
        grid.setColumnStretch(1, 1)
        grid.setColumnStretch(2, 1)
        self.hint = theme.dim(QLabel(NEEDS_TRUTH, wordWrap=True))
        parts = (grid, self.outlines, self.hint, self.other, 1)
        fill(QVBoxLayout(self), *parts, margins=(6, 8, 2, 8))

    @property
    def _seen(self) -> bool:
        """Whether it is open and in front; behind another tab Qt still calls it visible."""
        return "compare" in self._state.settings.panels

    @property
    def _settings(self) -> tuple[ComparedOptions, ...]:
        """Everything that determines the estimates and patches of A and B."""
        settings = self._state.settings
        kappa, least = settings.patch_rule
        return tuple(
            (s.options, FrameOptions(kappa if s.kappa is None else s.kappa, least))
            for s in settings.compared
        )

    def _on_settings(self, names: frozenset[str]) -> None:
        if "panels" in names and not self._seen:
            self._controller.compare(())
            self._take(NOT_MEASURED)
        elif names & ({"compared"} | PATCH_SETTINGS):
            self._ask_anew()
        else:
            if "panels" in names and self._measured is NOT_MEASURED:
                self._ask()
            self._show()

    def _on_frame(self, _: int, by_playback: bool) -> None:
        self._ask() if by_playback else self._ask_anew()

    def _ask_anew(self) -> None:
        """Request a measurement; until it arrives show none, as old numbers would look new."""
        self._take(NOT_MEASURED)
        self._ask()

    @property
    def _asks(self) -> bool:
        """Whether to request measurements: a source is open, and the panel is visible."""
        return self._seen and not self._state.facts.is_empty

    def _ask(self) -> None:
        if self._asks:
            self._controller.compare(self._settings)

    def _on_compared(
        self, settings: tuple[ComparedOptions, ...], measured: tuple[ComparedResult | str, ...]
    ) -> None:
        if self._seen and settings == self._settings:
            self._take(measured)

    def _on_failed(self, failed: Failed) -> None:
        if failed.key == "compare":
            self._take((failed.message, failed.message))

    def _take(self, measured: tuple[ComparedResult | str | None, ...]) -> None:
        if measured is not self._measured:
            self._measured = measured
            self._show()
            self.measured.emit(self._measured)

    def _show(self) -> None:
        estimate = self._controller.result.estimate
        colour = estimate is not None and estimate.flow
        self.hint.setText(f"{DEPTH_ALONE}\n{NEEDS_TRUTH}" if colour else NEEDS_TRUTH)
        for column, one in zip((self.a, self.b), self._measured, strict=True):
            column.show_measured(one, self._state.units, SOLVING if self._asks else DASH)
