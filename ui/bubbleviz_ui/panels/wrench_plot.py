"""Plot of the estimated force over the force of a wrench sensor."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPointF

from bubbleviz_ui.model.frame_history import MEASURED_FORCE
from bubbleviz_ui.model.registry import PLOTS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.panels.time_plot import FramePlot
from bubbleviz_ui.shell.theme import BLUE, ORANGE

DOT, RING = 4, 9
"""Sizes of a frame and of the mark around the one at the cursor, px."""
REACH = 8.0
"""Largest distance of a click from the middle of its point, px."""


class WrenchPlot(FramePlot):
    """Each computed frame as a point; on the line both forces are equal."""

    def __init__(self, state: SessionState) -> None:
        super().__init__("number", mouse="xy")
        self._state = state
        self.add_line(angle=45)
        self.dots, self.here = self.add_dots(DOT, BLUE), self.add_dots(RING, ORANGE, filled=False)
        self._forces = np.empty((2, 0))  # (2, F), measured and estimated, as drawn

    def draw(self, _: object = None) -> None:
        """Draw the frames with both forces, in the chosen unit."""
        unit, history = self._state.units.force, self._state.history
        measured = unit.per_si * history.quantity(MEASURED_FORCE)
        estimated = unit.per_si * history.quantity("force_n")
        both = np.isfinite(measured) & np.isfinite(estimated)
        self.dots.setData(measured[both], estimated[both])
        self._forces = np.where(both, [measured, estimated], np.nan)
        note = "" if np.isfinite(measured).any() else ": no wrench measured"
        self.write(f"{PLOTS['wrench'].title} ({unit.symbol}){note}")

    def show_cursor(self, frame: int, _: int | None) -> None:
        """Mark a frame, if it has both forces."""
        at = self._forces[:, frame : frame + 1]
        self.here.setData(*at[:, np.isfinite(at[0])])

    def frame_at(self, place: QPointF) -> int | None:
        """Frame whose point is at a position of the canvas, else None."""
        at, pixel = self.box.mapSceneToView(place), self.box.viewPixelSize()
        away = (self._forces - [[at.x()], [at.y()]]) / np.reshape(pixel, (2, 1))
        squares = np.where(np.isfinite(away), away, np.inf) ** 2
        inside = self.box.sceneBoundingRect().contains(place)
        if not (inside and squares.size and squares.sum(axis=0).min() <= REACH**2):
            return None
        return int(squares.sum(axis=0).argmin())
