"""Two sensors in one view: which one the panels show, and where the other one is."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.pipeline import Product
from bubbleviz.result import Result
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.sensor_client import SensorClient
from bubbleviz_ui.engine.solver import OpenRequest
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.engine.worker import Worker
from bubbleviz_ui.live.connection import LiveRun
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.settings import PATCH_SETTINGS
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene import Scene, SecondScene

ALONE_S = 0.15
"""A sensor without a picture for this long is not waited for by the other."""


class SensorPair(QObject):
    """The second sensor of a session, while it has one: asked for what is visible in the view.

    Time is the session's: while that stands still, it shows the frame of the same moment.
    """

    failed = Signal(object)  # A `Failed` of the second sensor

    def __init__(self, controller: Controller, scene: Scene, view: View) -> None:
        super().__init__()
        self._controller, self._scene, self._view = controller, scene, view
        self._state = state = controller.state
        self.second: SensorClient | None = None  # The one the panels do not show
        self.drawing: SecondScene | None = None
        self._run: LiveRun | None = None
        self._ending: list[Worker] = []
        self.chosen = 0  # Number of the one they show
        self._shown_s = 0.0
        controller.shown.connect(self._on_shown)
        state.frame_changed.connect(self._on_frame)
        state.playing_changed.connect(self._follow)
        state.frozen_changed.connect(self._follow)
        state.settings_changed.connect(self._on_settings)

    def prepare(self, run: LiveRun) -> None:
        """Take a run whose first sensor will be opened."""
        self.end()
        self._run, self.chosen = run, 0
        self._place()

    def begin(self) -> None:
        """The first sensor is open: start the second, where there is one."""
        run, state = self._run, self._state
        if run is None or len(run.frames) < 2 or self.second is not None:
            return
        if self.drawing is None:
            self.drawing = SecondScene(self._view, state.units, self._scene.ranges)
        sensor, frames = run.session.sensors[1].sensor, run.frames[1]
        self.second = second = SensorClient(state)
        second.extra_products = self._controller.client.extra_products
        self._listen(second)
        second.open(
            OpenRequest(
                source=Source.of_stream(frames),
                open_sensor=lambda: sensor,
                frame=0,
                demand=self._demand,
                options=state.settings.options,
                playing=True,
            )
        )

    def result_of(self, number: int) -> Result | None:
        """What the view shows of a sensor; None before its first frame."""
        client = self._controller.client if number == self.chosen else self.second
        return None if client is None else client.result

    def choose(self, number: int) -> bool:
        """Have the panels show the other sensor; whether they do."""
        other = self.second
        if other is None or other.opened is None or number == self.chosen:
            return False
        before, looked = self._T_W_B(self.chosen), self._scene.moved_by_user
        self._listen(other, on=False)
        self.chosen, self.second = number, self._controller.client
        self._place()
        self._controller.switch_to(other)
        self._listen(self.second)
        self._draw_second()
        self._follow()
        if looked:
            self._scene.move_camera(np.linalg.inv(self._T_W_B(number)) @ before)
        return True

    def ask_besides(self, products: frozenset[Product]) -> None:
        """Have both sensors make what goes out, too."""
        self._controller.client.extra_products = products
        if self.second is not None:
            self.second.extra_products = products

    def end(self) -> None:
        """One sensor again, or none; the other one's solver thread ends by itself."""
        second, self.second, self._run = self.second, None, None
        if second is not None:
            self._ending = [each for each in [*self._ending, second.worker] if not each.close(0.0)]
        if self.drawing is not None:
            self.drawing.hide()
        self._scene.place(np.eye(4), np.empty((0, 3)), None)

    def close(self) -> None:
        """End, and wait for solver threads that have not ended."""
        self.end()
        for worker in self._ending:
            worker.close()

    # -- what the second sensor does ----------------------------------------------------------

    @property
    def _demand(self) -> Demand:
        """What is visible in the view."""
        return Demand.of(replace(self._state.settings, panels=frozenset()))

    @property
    def _playing(self) -> bool:
        return self._state.playing and not self._state.frozen

    def _follow(self) -> None:
        """Go on with the session, or show the frame of its moment."""
        second, run, facts = self.second, self._run, self._state.facts
        if second is None or second.opened is None or run is None or facts is None:
            return
        if self._playing:
            second.request_newest(self._demand, at_once=True)
        else:
            time_s = float(facts.times_s[self._state.frame])
            second.request_frame(run.frames[1 - self.chosen].at(time_s), self._demand)

    def _listen(self, client: SensorClient, *, on: bool = True) -> None:
        for signal, slot in (
            (client.opened_source, self._on_second_open),
            (client.solved, self._on_second_solved),
            (client.paused, self._on_second_paused),
            (client.failed, self.failed),
        ):
            signal.connect(slot) if on else signal.disconnect(slot)

    def _on_second_paused(self) -> None:
        if self._playing:
            self._follow()

    def _on_second_solved(self, _: object, newest: bool) -> None:
        """Go on at once, as the chosen one does: neither waits for the other.

        A frame that was asked for while they went on may come when they stand still, at another
        moment.
        """
        if self._playing or newest:
            self._follow()
        self._show()

    @property
    def _alone(self) -> bool:
        """Whether no picture of the chosen sensor is about to come."""
        return not self._playing or time.perf_counter() - self._shown_s > ALONE_S

    def look(self) -> None:
        """Let the other sensor go on alone while the chosen one sends nothing."""
        if self._playing and self._alone:
            self._follow()

    def _on_shown(self) -> None:
        self._shown_s = time.perf_counter()
        if self.drawing is not None and not self.drawing.visible:
            self._show()
        if self._playing:
            self._follow()

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not (by_playback and self._playing):
            self._follow()

    def _on_settings(self, names: frozenset[str]) -> None:
        if self.second is not None:
            if names & PATCH_SETTINGS:
                self.second.history.forget_patches()
            self._show()
            self._follow()

    # -- where it is --------------------------------------------------------------------------

    def _T_W_B(self, number: int) -> np.ndarray:
        if self._run is None:
            raise RuntimeError("nothing is connected")
        return self._run.preset.sensors[number].T_W_B

    def _T_chosen_other(self) -> np.ndarray:
        return np.linalg.inv(self._T_W_B(self.chosen)) @ self._T_W_B(1 - self.chosen)

    def _place(self) -> None:
        """Tell the scene where the chosen sensor is, and the room the other one takes."""
        run, opened = self._run, None if self.second is None else self.second.opened
        if run is None or len(run.frames) < 2:
            self._scene.place(np.eye(4), np.empty((0, 3)), None)
            return
        beside = np.empty((0, 3))
        if opened is not None:
            T = self._T_chosen_other()
            beside = opened.mesh.nodes @ T[:3, :3].T + T[:3, 3]
        self._scene.place(self._T_W_B(self.chosen), beside, run.preset.sensors[self.chosen].colour)

    def _on_second_open(self, _: object) -> None:
        looked = self._scene.moved_by_user
        self._place()
        if not looked:
            self._scene.reset_view()
        self._draw_second()
        self._follow()

    def _draw_second(self) -> None:
        """Place the second sensor in the view, and draw it."""
        run, second, drawing = self._run, self.second, self.drawing
        if run is None or second is None or drawing is None or second.opened is None:
            return
        opened, place = second.opened, run.preset.sensors[1 - self.chosen]
        drawing.set_sensor(opened.sensor, opened.mesh, self._T_chosen_other(), place.colour)
        self._show()

    def _show(self) -> None:
        """Draw with the chosen sensor's next picture: two sensors cost one picture, not two.

        Not before it has one: until then the colour bars are those of what was open before.
        """
        result = None if self.second is None else self.second.result
        if self.drawing is None or result is None or self._controller.result is None:
            return
        self.drawing.show(result, self._state.settings)
        if self._alone:
            self._view.refresh()
