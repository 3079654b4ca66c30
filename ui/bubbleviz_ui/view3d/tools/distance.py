"""The distance between two points one has clicked."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.layer import add_mark
from bubbleviz_ui.view3d.render_view import View


class Distance:
    """Two points and the line between them; a third click begins anew.

    Attributes
    ----------
    points_m : list of (3,) arrays
        What was clicked, in B.
    """

    def __init__(self, view: View) -> None:
        self._view = view
        self.points_m: list[np.ndarray] = []
        self._poly = pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1])
        dots = {"point_size": 10, **view.quality.points}
        self._line = add_mark(view, self._poly, color=theme.GREEN, line_width=2, lighting=False)
        self._dots = add_mark(view, self._poly, color=theme.GREEN, **dots)
        self.clear()

    @property
    def length_m(self) -> float | None:
        """Distance in m; None before the second click."""
        if len(self.points_m) < 2:
            return None
        return float(np.linalg.norm(self.points_m[1] - self.points_m[0]))

    @property
    def middle_m(self) -> np.ndarray:
        """Middle (3,) of what was clicked, in B."""
        middle: np.ndarray = np.mean(self.points_m, axis=0)
        return middle

    def add(self, point_m: np.ndarray) -> None:
        """Take a point (3,) in B."""
        self.points_m = [*self.points_m, point_m][-2:] if len(self.points_m) < 2 else [point_m]
        self._poly.points[:] = np.array([self.points_m[0], self.points_m[-1]])
        self._poly.Modified()
        self._dots.visibility = True
        self._line.visibility = len(self.points_m) == 2
        self._view.refresh()

    def clear(self) -> None:
        """Forget the points."""
        self.points_m = []
        self._dots.visibility = self._line.visibility = False
        self._view.refresh()
