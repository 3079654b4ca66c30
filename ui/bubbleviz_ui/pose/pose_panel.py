"""Pose panel: object, initial pose, single fit or tracking, quality of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.files import SUFFIXES, angles_of_pose, pose_of_angles, presets_folder
from bubbleviz.result import Pose
from bubbleviz.wording import count_of
from bubbleviz_ui.model.registry import LAYERS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import POSE_SETTINGS, Settings
from bubbleviz_ui.model.throttle import Throttle
from bubbleviz_ui.model.units import UNIT_CHOICES, Unit, Units
from bubbleviz_ui.panels.plot_host import Part, Plot, PlotHost
from bubbleviz_ui.panels.time_plot import isolated
from bubbleviz_ui.pose.pose_session import NUMBERS, has_pose, pose_report, pose_texts
from bubbleviz_ui.shell.binding import bind_membership, control
from bubbleviz_ui.shell.dock import fill, push_button
from bubbleviz_ui.shell.file_dialogs import file_to_open, name_of_output, new_file
from bubbleviz_ui.shell.theme import BLUE, ORANGE

if TYPE_CHECKING:
    from bubbleviz.output import PoseRow
    from bubbleviz_ui.pose.pose_session import PoseSession


# Plots of fitness and rmse over the iterations of a fit, and over time.

Below = Literal["number", "seconds"]
HEIGHT = 109
"""Height of a plot with its heading, screen pixels."""


class Curves(PlotHost):
    """Fitness and rmse over the iterations of the last fit, and over the frames so far.

    `iterations, frames`: Curves of fitness and rmse.
    """

    def __init__(self, units: Units) -> None:
        super().__init__(self._fill)
        self._units = units
        self.setMinimumHeight(2 * HEIGHT)
        self.setToolTip(
            "Fitness and rmse. Top: at each iteration of both stages; bottom: of each frame so far"
        )

    def _fill(self) -> list[Part]:
        self.iterations, self.frames = _pair("number"), _pair("seconds")
        every = [*self.iterations, *self.frames]
        self.arrange([curve.item for curve in every], columns=2)
        return list(every)

    def draw(self, pose: Pose | None, rows: Sequence[PoseRow]) -> None:
        """Draw the iterations of a fit, both stages one after the other, and the frames so far."""
        if not self.ready:
            return
        fits = () if pose is None else (pose.stage_one, pose.stage_two)
        stages = [stage.history for stage in fits if stage is not None]
        both = np.concatenate([np.zeros((0, 2)), *stages])
        numbers, time_s, *quality = (
            np.array([(row["frame"], row["time_s"], row["fitness"], row["rmse_m"]) for row in rows])
            .reshape(-1, 4)
            .T
        )
        breaks = np.flatnonzero(np.diff(numbers) > 1) + 1  # at missing frames
        times = np.insert(time_s, breaks, time_s[breaks])
        values = np.insert(np.array(quality), breaks, np.nan, axis=1)
        for k, unit in enumerate((self._units.share, self._units.length)):
            change = len(stages[0]) if stages else None
            self.iterations[k].draw(np.arange(len(both)), both[:, k], unit, change)
            self.frames[k].draw(times, values[k], unit)


def _pair(below: Below) -> tuple[Curve, Curve]:
    return Curve("fitness", BLUE, below, top=1.0), Curve("rmse", ORANGE, below)


class Curve(Plot):
    """One quantity from 0, with its last value in the heading.

    `below`: Quantity of the bottom axis.
    `top`: Upper end of the axis, SI; by default the largest value.
    """

    def __init__(self, name: str, colour: str, below: Below, top: float | None = None) -> None:
        super().__init__(below)
        self._name, self._colour, self._top = name, colour, top
        self.label.setPos(0.0, self.label.y())  # above the axis, too, as the plot is narrow
        self.curve = self.add_curve(colour, symbolSize=4, symbolBrush=colour, symbolPen=None)
        self.change = self.add_line()

    def draw(
        self, x: np.ndarray, values: np.ndarray, unit: Unit, change: int | None = None
    ) -> None:
        """Draw values (k,) in SI, NaN if missing, with a line at the start of stage two."""
        symbol = "o" if isolated(values).any() else None
        self.curve.setData(x, unit.from_si(1.0) * values, symbol=symbol)
        top = self._top or float(np.nanmax(values, initial=0.0))
        if top > 0.0:
            self.box.setYRange(0.0, unit.from_si(top), padding=0.05)
        self.change.setVisible(change is not None)
        if change is not None:
            self.change.setValue(change - 0.5)
        known = len(values) and np.isfinite(values[-1])
        last = f" {unit.text(float(values[-1]))}" if known else f", {unit.symbol}"
        self.write(f'<span style="color:{self._colour}">{self._name}{last}</span>')


# Boxes for the initial pose.

MAX_DISTANCE_M = 0.5  # from the origin of B, beyond any sensor
NAMES = ("x", "y", "z")


class StartBoxes(QWidget):
    """Position and rotation (about fixed x, then y, then z) of O in B."""

    edited = Signal(object)  # T_B_O (4, 4)

    def __init__(self, units: Units) -> None:
        super().__init__()
        self._units = units
        self.places, self.angles = ([self._box() for _ in NAMES] for _ in range(2))
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        for column, name in enumerate(NAMES):
            grid.addWidget(QLabel(name), 0, 2 * column)
            grid.addWidget(self.places[column], 0, 2 * column + 1)
            grid.addWidget(QLabel(f"r{name}"), 1, 2 * column)
            grid.addWidget(self.angles[column], 1, 2 * column + 1)
            grid.setColumnStretch(2 * column + 1, 1)
            self.places[column].setToolTip(f"Initial pose: {name} of T_B_O")
            self.angles[column].setToolTip(f"Initial pose: rotation about {name} of B, degrees")
        for box in self.angles:
            box.setRange(-180.0, 180.0)
            box.setDecimals(1)
            box.setSuffix("°")
            box.setWrapping(True)
        self.fit_units()

    def fit_units(self) -> None:
        unit = self._units.length
        for box in self.places:
            with QSignalBlocker(box):
                box.setRange(-unit.from_si(MAX_DISTANCE_M), unit.from_si(MAX_DISTANCE_M))
                box.setDecimals(max(1, unit.digits - 1))
                box.setSingleStep(unit.from_si(1e-3))
                box.setSuffix(f" {unit.symbol}")

    def show_pose(self, T_B_O: np.ndarray) -> None:
        """Show a pose (4, 4) in the boxes."""
        angles = np.degrees(angles_of_pose(T_B_O))
        place = self._units.length.from_si(1.0) * T_B_O[:3, 3]
        values = zip([*self.places, *self.angles], [*place, *angles], strict=True)
        for box, value in values:
            with QSignalBlocker(box):
                box.setValue(float(value))

    def pose(self) -> np.ndarray:
        """T_B_O (4, 4) of the boxes."""
        place = np.array([self._units.length.to_si(box.value()) for box in self.places])
        return pose_of_angles(place, np.radians([box.value() for box in self.angles]))

    def _box(self) -> QDoubleSpinBox:
        box = QDoubleSpinBox()
        box.setButtonSymbols(QDoubleSpinBox.ButtonSymbols.NoButtons)
        box.setKeyboardTracking(False)
        box.setMinimumWidth(46)
        box.valueChanged.connect(lambda _: self.edited.emit(self.pose()))
        return box


MESHES = f"Meshes ({' '.join('*' + suffix for suffix in SUFFIXES)});;All files (*)"
NONE, FROM_FILE = "none", "from a file…"
EVERY_MS = 150
"""Update period of the curves."""


class PosePanel(QWidget):
    """Controls of a `PoseSession`."""

    def __init__(self, state: SessionState, session: PoseSession) -> None:
        super().__init__()
        self._state, self.session = state, session
        self.curves = Curves(state.units)
        self.curves.hide()  # until there is a pose
        self.object = QComboBox()
        self.unit = control(state, "pose_unit")
        self.start = StartBoxes(state.units)
        self.search = QCheckBox("Search pose")
        self.from_here = push_button(
            "Start from here", "Use the pose below as the initial pose", self._start_here
        )
        self.once = push_button(
            "Fit once",
            "Register the object in this frame, both stages (section VI of the paper)",
            session.fit_once,
        )
        self.other = push_button(
            "", "Other poses from the search that fit as well: fit the next one", session.fit_other
        )
        self.track = push_button("Track", Settings.info("pose_track").tip, session.track)
        self.reset = push_button(
            "Reset", "Discard all poses and stop tracking (Ctrl+Shift+F)", session.reset
        )
        self.patch = QCheckBox(LAYERS["object_patch"].title)
        self.stage = control(state, "pose_stage")
        self.copy = push_button(
            "Copy", "T_B_O as text: position in m, quaternion x y z w, 4×4 matrix", self._copy
        )
        self.csv = push_button(
            "CSV…",
            "Every processed frame with status and T_B_O in m; a lost frame has the last good pose",
            lambda: self._export("csv"),
        )
        self.tum = push_button(
            "TUM…",
            "TUM trajectory of the frames in which the object was found: time in s, T_B_O in m",
            lambda: self._export("tum"),
        )
        self.values = {name: QLabel() for name in NUMBERS}
        self._fill()
        self._lay_out()
        self._connect()
        self._redraw = Throttle(self, self._draw_curves, EVERY_MS)
        self._write()

    def use_file(self, path: Path) -> None:
        """Register the object of a mesh file, in the chosen unit."""
        self.session.choose(str(path.absolute()))

    def _fill(self) -> None:
        self.object.setToolTip(
            "Object to register: a preset or a mesh file, which can be dropped on the window"
        )
        self.object.addItem(NONE, None)
        for path in sorted(presets_folder("objects").glob("*.*")):
            self.object.addItem(path.stem.replace("_", " "), path.stem)
        self.object.addItem(FROM_FILE, FROM_FILE)
        self.search.setChecked(True)
        self.search.setToolTip("Search all orientations instead of starting from an initial pose")
        self.track.setCheckable(True)
        self.patch.setToolTip(LAYERS["object_patch"].tip)

    def _lay_out(self) -> None:
        column = QVBoxLayout(self)
        column.setContentsMargins(12, 10, 12, 10)
        column.setSpacing(6)
        for row in (
            (self.object, self.unit),
            (self.search, self.from_here),
            (self.start,),
            (self.once, self.track, self.reset),
        ):
            column.addLayout(fill(QHBoxLayout(), *row))
        self.form = form = QFormLayout()
        form.setHorizontalSpacing(12)
        for name, title in NUMBERS.items():
            form.addRow(title, self.values[name])
        form.insertRow(3, "T_B_O", self.copy)
        form.insertRow(1, "Other poses", self.other)
        form.addRow(self.stage.accessibleName(), self.stage)
        form.addRow("Outline", self.patch)
        column.addLayout(form)
        export = fill(QHBoxLayout(), QLabel("Export"), self.csv, self.tum)
        fill(column, self.curves, export, 1)
        for value in self.values.values():
            value.setWordWrap(True)
            value.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.values["place"].setToolTip(
            "Position of T_B_O: the object's origin in the bubble frame B"
        )
        self.values["turn"].setToolTip("Rotation of T_B_O: about fixed x, then y, then z of B")

    def _connect(self) -> None:
        session, state = self.session, self._state
        self.object.activated.connect(lambda _: self._on_object())
        bind_membership(self.patch, state, "layers", "object_patch")
        self.search.toggled.connect(lambda on: session.set_start(None if on else self.start.pose()))
        self.start.edited.connect(session.set_start)
        self.curves.seen.connect(self._draw_curves)
        session.changed.connect(self._on_changed)
        state.settings_changed.connect(self._on_settings)

    def _start_here(self) -> None:
        pose = self.session.pose
        if has_pose(pose):
            self.session.set_start(pose.T_B_O)

    def _copy(self) -> None:
        pose = self.session.pose
        if has_pose(pose):
            QGuiApplication.clipboard().setText(pose_report(pose, self.session.touched))

    def _on_object(self) -> None:
        name = self.object.currentData()
        if name != FROM_FILE:
            self.session.choose(name)
            return
        path = file_to_open(self, "Object", MESHES, of="object")
        if path is not None:
            self.use_file(path)
        else:
            self._show_object()

    def _show_object(self) -> None:
        name = self.session.object_name
        if name is not None and self.object.findData(name) < 0:
            self.object.insertItem(self.object.count() - 1, Path(name).name, name)
        self.object.setCurrentIndex(self.object.findData(name))  # does not emit `activated`

    def _show_start(self) -> None:
        start = self.session.start
        with QSignalBlocker(self.search):
            self.search.setChecked(start is None)
        if start is not None and not np.allclose(self.start.pose(), start, atol=1e-9):
            self.start.show_pose(start)  # else keep the angles as typed

    def _export(self, form: Literal["csv", "tum"]) -> None:
        proposed = name_of_output(self._state.title, f"poses.{form}")
        path, _ = new_file(self, "Export poses", proposed, of="export")
        if path is None:
            return

        def write() -> str:
            count = self.session.export(path, form)
            return f"Exported {count_of(count, 'frame')} to {path}"

        self._state.messages.report("export of poses", path, write)

    def _on_settings(self, names: frozenset[str]) -> None:
        if names & UNIT_CHOICES.keys():
            self.start.fit_units()
            self._on_changed()
        if names & {"pose_start", *UNIT_CHOICES}:
            self._show_start()
        if names & POSE_SETTINGS:
            self._show_object()
        self._on_changed()

    def _on_changed(self) -> None:
        self._write()
        self._redraw.request()

    def _write(self) -> None:
        """Update controls and numbers of the pose shown."""
        session = self.session
        idle, has = not session.busy, session.obj is not None
        self.object.setEnabled(idle)
        self.unit.setEnabled(idle)
        for widget in (self.search, self.start, self.once, self.track, self.reset):
            widget.setEnabled(idle and has)
        self.other.setEnabled(idle)
        self.other.setText(f"{len(session.others)} fit as well: fit the next")
        self.form.setRowVisible(self.other, bool(session.others))
        known = has_pose(session.pose)
        self.from_here.setEnabled(idle and has and known)
        self.copy.setEnabled(known)
        for button in (self.csv, self.tum):
            button.setEnabled(idle and bool(session.rows))
        self.track.setChecked(self._state.settings.pose_track)
        self._show_object()
        for name, text in pose_texts(self.session, self._state.units).items():
            self.values[name].setText(text)
        title, by_object = LAYERS["object_patch"].title, self.session.object_patch
        area = "" if by_object is None else self._state.units.area.text(by_object.area_m2)
        self.patch.setText(f"{title}: {area}" if area else title)

    def _draw_curves(self) -> None:
        if self.session.pose is not None:
            self.curves.show()
        rows = [self.session.rows[k] for k in sorted(self.session.rows)]
        self.curves.draw(self.session.pose, rows)
