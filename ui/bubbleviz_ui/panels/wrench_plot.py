"""Plot of the estimated force over the force of a wrench sensor."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPointF

from bubbleviz_ui.model.frame_history import MEASURED_FORCE, FrameHistory
from bubbleviz_ui.model.registry import PLOTS
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.panels.plot_host import Plot
from bubbleviz_ui.shell.theme import BLUE, ORANGE

DOT, RING = 4, 9
"""Sizes of a frame and of the mark around the one at the cursor, px."""
REACH = 8.0
"""Largest distance of a click from the middle of its point, px."""


class WrenchPlot(Plot):
    """Each computed frame as a point; on the line both forces are equal."""

    def __init__(self) -> None:
        super().__init__("number", mouse="xy")
        self.add_line(angle=45)
        self.dots, self.here = self.add_dots(DOT, BLUE), self.add_dots(RING, ORANGE, filled=False)
        self._forces = np.empty((2, 0))  # (2, F), measured and estimated, as drawn

    def draw(self, history: FrameHistory, units: Units) -> None:
        """Draw the frames with both forces, in the chosen unit."""
        unit = units.force
        measured = unit.per_si * history.quantity(MEASURED_FORCE)
        estimated = unit.per_si * history.quantity("force_n")
        both = np.isfinite(measured) & np.isfinite(estimated)
        self.dots.setData(measured[both], estimated[both])
        self._forces = np.where(both, [measured, estimated], np.nan)
        note = "" if np.isfinite(measured).any() else ": no wrench measured"
        self.write(f"{PLOTS['wrench'].title} ({unit.symbol}){note}")

    def show_cursor(self, frame: int) -> None:
        """Mark a frame, if it has both forces."""
        at = self._forces[:, frame : frame + 1]
        self.here.setData(*at[:, np.isfinite(at[0])])

    def frame_at(self, place: QPointF) -> int | None:
        """Frame whose point is at a position of the scene, else None."""
        at, pixel = self.box.mapSceneToView(place), self.box.viewPixelSize()
        away = (self._forces - [[at.x()], [at.y()]]) / np.reshape(pixel, (2, 1))
        squares = np.where(np.isfinite(away), away, np.inf) ** 2
        if not squares.size or squares.sum(axis=0).min() > REACH**2:
            return None
        return int(squares.sum(axis=0).argmin())
