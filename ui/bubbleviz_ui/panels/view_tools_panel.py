"""3-D tools panel: viewpoints, probe, distance with profile, section, exaggeration, screenshots."""

from __future__ import annotations

from functools import partial
from operator import itemgetter
from pathlib import Path

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtGui import QImage, QPixmap
from PySide6.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QSlider,
    QSpinBox,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.diagnostics import Probed
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.hover import Hover
from bubbleviz_ui.engine.solver import Opened
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.model.units import UNIT_CHOICES
from bubbleviz_ui.panels.images_panel import probe_lines
from bubbleviz_ui.panels.profile_plot import ProfilePlot
from bubbleviz_ui.shell.binding import Binding, control, form
from bubbleviz_ui.shell.dock import fill, push_button
from bubbleviz_ui.shell.file_dialogs import file_to_save, name_of_output, write_picture
from bubbleviz_ui.shell.shortcuts import STEP, Shortcuts
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import Scene
from bubbleviz_ui.view3d.tools import Turntable, Viewpoint, picture_of

VIEWS: dict[Viewpoint, str] = {
    "top": "Top", "side": "Side", "front": "Front", "camera": "Camera"
}  # fmt: skip
TOOLS = {
    "rotate": ("Rotate", "&Clear probe", "Esc", "Drag to rotate the scene, wheel to zoom"),
    "probe": (
        "Probe",
        "&Probe a point",
        "",
        "Click on the membrane or a measured point to show its numbers until Esc",
    ),
    "distance": (
        "Distance",
        "Measure &distance and profile",
        "",
        "Click on two points: their distance, and a profile of height and pressure between them; a "
        "third starts again",
    ),
}
"""Text of each button, title in the menu, keys and tip."""
VIEW_FROM = f"View{STEP}View from"
HINTS = {
    "rotate": ("Drag rotates, wheel zooms,", "middle button moves", ""),
    "probe": ("Click on the membrane", "or on a measured point", ""),
    "distance": ("Click on two points", "", ""),
}
"""Shown while there are no numbers."""
SHOWN = frozenset({*UNIT_CHOICES, "section_axis", "section_at_m", "exaggeration"})
"""Settings that this panel shows, or that move the probed place in the view."""
SECTION_STEPS = 200
WIDTH = 286
"""Width of the numbers of a probed place, screen pixels."""


class ViewTools(QWidget):
    """Controls of the 3-D view other than layers."""

    def __init__(
        self, state: SessionState, controller: Controller, view: View, scene: Scene
    ) -> None:
        super().__init__()
        self._state, self._view, self._scene = state, view, scene
        self.tool = "rotate"
        self.ends_m: list[np.ndarray] = []  # Points (3,) in B clicked for a distance
        self.turntable = Turntable(view)
        self.picked = Hover(controller)
        self.profile = ProfilePlot(state, controller)
        self._extent_m = 0.1
        self.views = {name: QToolButton() for name in VIEWS}
        self.tools = {name: QToolButton() for name in TOOLS}
        self.turn = QToolButton()
        self.reading = [QLabel() for _ in range(3)]
        self.colour_map = control(state, "colour_map")
        self.exaggeration = control(state, "exaggeration")
        self.section = control(state, "section_axis")
        self.flipped = control(state, "section_flipped")
        self.section_at = QSlider(Qt.Orientation.Horizontal)
        self.section_at.setRange(-SECTION_STEPS, SECTION_STEPS)
        self.section_at.setToolTip(Settings.info("section_at_m").tip)
        self.section_text = QLabel()
        self.width_box, self.height_box = (_pixels(state, side) for side in range(2))
        self.save = push_button(
            "Save…", "Save a picture of the 3-D view at this size, PNG", self._choose_file
        )
        rows = form(self.colour_map, self.exaggeration, self.section)
        rows.addRow(self.section_text, self.section_at)
        rows.addRow("", self.flipped)
        rows.addRow("Picture", _row(self.width_box, QLabel("×"), self.height_box, self.save))
        fill(
            QVBoxLayout(self),
            _row(*self.views.values()),
            _row(*self.tools.values(), self.turn),
            *self.reading,
            self.profile,
            rows,
            1,
            margins=(8, 10, 4, 10),
            spacing=6,
        )
        self.setMinimumWidth(WIDTH)
        self.section_text.setMinimumWidth(self.fontMetrics().horizontalAdvance("at −0.88888 m"))
        self._bind(state)
        self._view.clicked.connect(self._on_clicked)
        self.picked.changed.connect(self._show_reading)
        controller.opened.connect(self._on_opened)
        self._on_settings()
        state.follow(SHOWN, self._on_settings)

    def use_actions(self, shortcuts: Shortcuts) -> None:
        """Give the buttons the function, state and tool tip of the menu's actions."""
        titles = {name: title.replace("&", "") for name, (_, title, *_) in TOOLS.items()}
        shortcuts.give({self.views[name]: title for name, title in VIEWS.items()}, VIEW_FROM)
        shortcuts.give({self.tools[name]: title for name, title in titles.items()}, "View")
        shortcuts.give({self.turn: "Turntable"}, "View")
        for name, (text, *_) in TOOLS.items():
            self.tools[name].defaultAction().setIconText(text)
        self.use_tool(self.tool)

    def _bind(self, state: SessionState) -> None:
        self._at = Binding(
            self.section_at,
            state,
            "section_at_m",
            lambda at_m: round(SECTION_STEPS * at_m / self._extent_m),
            lambda step: self._extent_m * step / SECTION_STEPS,
        )

    # -- pointing -----------------------------------------------------------------------------

    def use_tool(self, name: str) -> None:
        """Select what a click in the view does: `rotate` (nothing), `probe` or `distance`."""
        self.tool = name
        for each, button in self.tools.items():
            button.setChecked(each == name)
        self.picked.point_at(None)
        self.ends_m = []
        pointer = Qt.CursorShape.ArrowCursor if name == "rotate" else Qt.CursorShape.CrossCursor
        self._view.setCursor(pointer)
        self._show_reading()

    def _on_clicked(self, x: float, y: float) -> None:
        if self.tool == "rotate":
            return
        point = self._scene.pick(x, y)
        if self.tool == "probe":
            self.picked.point_at(point)
        elif point is not None:
            self.ends_m = [*self.ends_m, point] if len(self.ends_m) == 1 else [point]
        self._show_reading()

    def _show_reading(self, _: Probed | None = None) -> None:
        """Show the probed place or the distance, in the view and in the panel."""
        place, ends = self.picked.place, self.ends_m
        if ends:
            self._scene.callout.show_distance(ends)
        else:
            self._scene.pin(place)
        lines, length = HINTS[self.tool], self._state.units.length
        if place is not None:
            lines = probe_lines(place, self._state.units)
        elif len(ends) == 2:
            dx, dy, dz = (f"{length.from_si(d):.{length.digits}f}" for d in ends[1] - ends[0])
            distance = length.text(float(np.linalg.norm(ends[1] - ends[0])))
            lines = (f"distance {distance}", f"Δx {dx} · Δy {dy}", f"Δz {dz} {length.symbol}")
        elif ends:
            lines = ("Click on the other point", "", "")
        for label, line in zip(self.reading, lines, strict=True):
            label.setText(line)
        self.profile.show_line(np.array(ends) if len(ends) == 2 else None)

    # -- settings -----------------------------------------------------------------------------

    def _on_opened(self, opened: Opened) -> None:
        self._extent_m = float(abs(opened.mesh.nodes).max())
        self.ends_m = []
        self._at.refresh()
        self._show_reading()

    def _on_settings(self) -> None:
        settings, length = self._state.settings, self._state.units.length
        self.section_text.setText(f"at {length.text(settings.section_at_m)}")
        for box in (self.section_at, self.flipped):
            box.setEnabled(settings.section_axis is not None)
        self._show_reading()

    # -- pictures -----------------------------------------------------------------------------

    def save_picture(self, path: Path) -> None:
        """Save a screenshot of the 3-D view at the chosen size."""
        pixels = picture_of(self._view, *self._state.settings.picture_size)
        height, width = pixels.shape[:2]
        image = QImage(pixels.data, width, height, 3 * width, QImage.Format.Format_RGB888)
        write = partial(write_picture, path, QPixmap.fromImage(image))
        self._state.messages.report("picture", path, write)

    def _choose_file(self) -> None:
        title, kinds = "Save picture of the 3-D view", "PNG images (*.png)"
        proposed = name_of_output(self._state.title, "view.png")
        path = file_to_save(self, title, proposed, kinds, of="picture")
        if path is not None:
            self.save_picture(path)


def _pixels(state: SessionState, side: int) -> QSpinBox:
    """Box of the width (0) or height (1) of pictures."""

    def with_side(pixels: int) -> tuple[int, ...]:
        size = state.settings.picture_size
        return (pixels, size[1]) if side == 0 else (size[0], pixels)

    info = Settings.info("picture_size")
    box: QSpinBox = control(state, "picture_size", info, itemgetter(side), with_side)
    box.setButtonSymbols(QSpinBox.ButtonSymbols.NoButtons)
    return box


def _row(*widgets: QWidget) -> QHBoxLayout:
    return fill(QHBoxLayout(), *widgets, 1, spacing=4)
