"""Probing with the mouse over the 3-D view, and locking of its colour scales."""

from __future__ import annotations

from PySide6.QtCore import QObject

from bubbleviz_ui.engine.hover import Hover
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.throttle import Throttle
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import Scene

EVERY_MS = 30
"""Picking takes some ms, and there are hundreds of mouse moves per second."""
LOCK_TIP = "Click to lock this scale, again to let it follow the data"


class Pointing(QObject):
    """Probes the place under the mouse; during playback only for the images panel."""

    def __init__(self, state: SessionState, view: View, scene: Scene, hover: Hover) -> None:
        super().__init__(view)
        self._state, self._scene, self._hover = state, scene, hover
        self._at = (0.0, 0.0)
        self._due = Throttle(self, self._pick, EVERY_MS)
        self._view = view
        view.mouse_moved.connect(self._on_moved)
        view.clicked.connect(self._on_clicked)
        view.mouse_left.connect(self._on_left)
        state.playing_changed.connect(self._on_playing)
        hover.changed.connect(scene.mark)

    @property
    def _enabled(self) -> bool:
        return not self._state.playing or "images" in self._state.settings.panels

    def _on_moved(self, x: float, y: float) -> None:
        self._at = (x, y)
        self._view.setToolTip(LOCK_TIP if self._scene.bar_at(x, y) is not None else "")
        if self._enabled:
            self._due.request()

    def _on_clicked(self, x: float, y: float) -> None:
        """Lock the scale of a colour bar, or let it follow the data again."""
        bar = self._scene.bar_at(x, y)
        if bar is not None:
            locked = getattr(self._state.settings, bar.setting) is not None
            self._state.change(**{bar.setting: None if locked else bar.end})

    def _on_playing(self) -> None:
        if not self._enabled:
            self._on_left()

    def _on_left(self) -> None:
        self._due.stop()
        self._hover.point_at(None)

    def _pick(self) -> None:
        self._hover.point_at(self._scene.pick(*self._at))
