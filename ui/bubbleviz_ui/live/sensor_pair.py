"""Two sensors in one view: which one the panels show, and where the other one is."""

from __future__ import annotations

import time

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.result import Result
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.live.connection import LiveRun
from bubbleviz_ui.live.second_sensor import SecondSensor
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import Scene
from bubbleviz_ui.view3d.second_scene import SecondScene

ALONE_S = 0.15
"""A sensor without a picture for this long is not waited for by the other."""


class SensorPair(QObject):
    """The second sensor of a session, while it has one.

    Attributes
    ----------
    failed : Signal
        A `Failed` of the second sensor.
    second : SecondSensor or None
        The one the panels do not show.
    chosen : int
        Number of the one they show.
    """

    failed = Signal(object)

    def __init__(self, controller: Controller, scene: Scene, view: View) -> None:
        super().__init__()
        self._controller, self._scene, self._view = controller, scene, view
        self.second_sensor: SecondSensor | None = None
        self.drawing: SecondScene | None = None
        self._run: LiveRun | None = None
        self.chosen = 0
        self._shown_s = 0.0
        controller.shown.connect(self._on_shown)
        state = controller.state
        state.frame_changed.connect(self._on_frame)
        state.playing_changed.connect(self._follow)
        state.frozen_changed.connect(self._follow)
        state.choices_changed.connect(self._on_choices)

    def prepare(self, run: LiveRun) -> None:
        """Take a run whose first sensor will be opened."""
        self.end()
        self._run, self.chosen = run, 0
        self._place()

    def begin(self) -> None:
        """The first sensor is open: start the second, where there is one."""
        run = self._run
        if run is None or len(run.frames) < 2 or self.second_sensor is not None:
            return
        if self.drawing is None:
            state = self._controller.state
            self.drawing = SecondScene(self._view, state.units, self._scene.ranges)
        state, live = self._controller.state, run.session.sensors[1]
        self.second_sensor = second = SecondSensor(state, live.sensor, run.frames[1])
        second.extra = self._controller.extra
        second.opened.connect(self._on_second_open)
        second.shown.connect(self._show)
        second.failed.connect(self.failed)

    def choose(self, number: int) -> bool:
        """Have the panels show the other sensor; whether they do."""
        second = self.second_sensor
        if second is None or second.open is None or number == self.chosen:
            return False
        other, before = second.give_up(), self._T_W_B(self.chosen)
        looked = self._scene.moved_by_user
        self.chosen = number
        second.take(self._controller.swap_sensor(other, self._place))
        self._draw_companion()
        if looked:
            self._scene.move_camera(np.linalg.inv(self._T_W_B(number)) @ before)
        return True

    def ask_besides(self) -> None:
        """Have the second sensor make what goes out, too."""
        if self.second_sensor is not None:
            self.second_sensor.extra = self._controller.extra

    def end(self) -> None:
        """One sensor again, or none."""
        second, self.second_sensor, self._run = self.second_sensor, None, None
        if second is not None:
            second.close()
        if self.drawing is not None:
            self.drawing.hide()
        self._scene.place(np.eye(4), np.empty((0, 3)), None)

    # -- inside -------------------------------------------------------------------------------

    def _T_W_B(self, number: int) -> np.ndarray:
        if self._run is None:
            raise RuntimeError("nothing is connected")
        return self._run.preset.sensors[number].T_W_B

    def _T_chosen_other(self) -> np.ndarray:
        return np.linalg.inv(self._T_W_B(self.chosen)) @ self._T_W_B(1 - self.chosen)

    def _place(self) -> None:
        """Tell the scene where the chosen sensor is, and the room the other one takes."""
        run, opened = self._run, None if self.second_sensor is None else self.second_sensor.open
        if run is None or len(run.frames) < 2:
            self._scene.place(np.eye(4), np.empty((0, 3)), None)
            return
        beside = np.empty((0, 3))
        if opened is not None:
            T = self._T_chosen_other()
            beside = opened.mesh.nodes @ T[:3, :3].T + T[:3, 3]
        self._scene.place(self._T_W_B(self.chosen), beside, run.preset.sensors[self.chosen].colour)

    def _on_second_open(self) -> None:
        looked = self._scene.moved_by_user
        self._place()
        if not looked:
            self._scene.reset_view()
        self._draw_companion()

    def _draw_companion(self) -> None:
        """Place the second sensor in the view, and draw it."""
        run, second, drawing = self._run, self.second_sensor, self.drawing
        if run is None or second is None or drawing is None or second.open is None:
            return
        opened, place = second.open, run.preset.sensors[1 - self.chosen]
        drawing.set_sensor(opened.sensor, opened.mesh, self._T_chosen_other(), place.colour)
        self._show(opened.result)

    def _show(self, result: Result) -> None:
        """Draw with the chosen sensor's next picture: two sensors cost one picture, not two."""
        if self.drawing is None or self.second_sensor is None:
            return
        self.drawing.show(result, self._controller.state.choices)
        if time.perf_counter() - self._shown_s > ALONE_S:
            self._view.refresh()

    def _on_shown(self, _: object) -> None:
        """Let both go on at once: neither takes the other's time."""
        self._shown_s = time.perf_counter()
        if self.second_sensor is not None and self._playing:
            self.second_sensor.follow()

    @property
    def _playing(self) -> bool:
        state = self._controller.state
        return state.playing and not state.frozen

    def look(self) -> None:
        """Let the other sensor go on alone while the chosen one sends nothing."""
        alone = time.perf_counter() - self._shown_s > ALONE_S
        if self.second_sensor is not None and alone and self._playing:
            self.second_sensor.follow()

    def _follow(self) -> None:
        if self.second_sensor is not None:
            self.second_sensor.follow()

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not by_playback:
            self._follow()

    def _on_choices(self) -> None:
        if self.second_sensor is not None and self.second_sensor.open is not None:
            self._show(self.second_sensor.open.result)
            self._follow()
