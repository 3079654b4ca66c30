"""Controller between model and solver thread: decides what to compute and when."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from PySide6.QtCore import QObject, QTimer, Signal

from bubbleviz.diagnostics import Inspection, Numbers
from bubbleviz.pipeline import FLOW_PRODUCTS, FrameOptions, Product
from bubbleviz.recordings import Frame
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.opening import Opening
from bubbleviz_ui.engine.player import Player
from bubbleviz_ui.engine.sensor_client import SensorClient
from bubbleviz_ui.engine.solver import ComparedOptions, Opened, Solved
from bubbleviz_ui.engine.source import PlacedSensor
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.model.demand import Demand, needed_products, plot_products, pose_products
from bubbleviz_ui.model.messages import SOURCE
from bubbleviz_ui.model.registry import PATCH
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import PATCH_SETTINGS, solver_title

# Analysis of all frames while the solver is idle.


class Analysis(QObject):
    """Computes the missing numbers of all frames, a batch at a time.

    `state`: Stores the numbers.
    `client`: Returns the sensor whose frames are analysed.
    """

    progressed = Signal(int, int)  # Frames done and requested; equal at the end

    def __init__(self, state: SessionState, client: Callable[[], SensorClient]) -> None:
        super().__init__()
        self._state, self._client = state, client
        self._frames: tuple[int, ...] = ()
        self._products: frozenset[Product] = frozenset()
        self._count, self._began_s, self._cached_only = 0, 0.0, False
        state.follow(PATCH_SETTINGS, self._recompute_patches)

    @property
    def busy(self) -> bool:
        return bool(self._frames)

    @property
    def remaining_s(self) -> float:
        """Time until the end at the mean rate so far; NaN before the first frame."""
        left = len(self._frames)
        done = self._count - left
        return left / done * (time.monotonic() - self._began_s) if done else math.nan

    def start(self) -> None:
        """Compute what the chosen plots need and is missing, for all frames.

        With colour where it is in use: all numbers are then by depth and colour. Playback pauses:
        the solver analyses while it is idle.
        """
        if self._state.facts.is_empty:
            return
        if not self.busy and not self._state.facts.live:
            self._state.set_playing(False)
        products = plot_products(self._state.settings)
        if needed_products(self._state.settings) & FLOW_PRODUCTS:
            products |= {"traction"}
        self._begin(products, self._state.history.missing(products), cached_only=False)

    def _recompute_patches(self) -> None:
        """Recompute patches outdated by another κ, from cached estimates."""
        if self.busy and not self._cached_only:
            self.start()
        else:
            self._begin(frozenset({"patch"}), self._state.history.outdated, cached_only=True)

    def stop(self) -> None:
        """Stop; numbers computed so far are kept."""
        self._frames, self._count = (), 0
        self.progressed.emit(0, 0)

    def _take(self, frames: tuple[int, ...], demand: Demand, numbers: list[Numbers | None]) -> None:
        """Store the numbers of the first frames, and request the others."""
        same = demand.patch_rule == self._state.settings.patch_rule
        known = {k: each for k, each in zip(frames, numbers, strict=False) if each}
        self._client().frames_counted.request()
        if frames is self._frames:  # else others were requested meanwhile
            self._state.remember(tuple(known), tuple(known.values()), same_patch=same)
            self._frames = frames[len(numbers) :]
            self._request_rest()

    def _begin(
        self, products: frozenset[Product], frames: np.ndarray, *, cached_only: bool
    ) -> None:
        self._products, self._cached_only = products, cached_only
        self._frames = tuple(int(k) for k in frames)
        self._count, self._began_s = len(self._frames), time.monotonic()
        self._request_rest()

    def _request_rest(self) -> None:
        self.progressed.emit(self._count - len(self._frames), self._count)
        if self._frames:
            options = FrameOptions(*self._state.settings.patch_rule)
            demand = Demand(self._products, options)
            frames, client = self._frames, self._client()
            function = partial(client.solver.analyse, frames, demand, cached_only=self._cached_only)
            client.worker.submit(function, partial(self._take, frames, demand), key="analyse")


COLD_SOLVE_DELAY_MS = 150
"""How long the cursor must stay at a frame before a cold solve, which avoids them while scrubbing.

A cold solve starts from rest instead of the previous frame, so that its result does not depend on
what was shown before."""


class Controller(QObject):
    """Requests what the visible layers and panels need of the frame at the cursor."""

    replaced = Signal()  # A source, or its sensor, by the one that was just `opened`
    opened = Signal(object)  # `Opened`: another source or sensor, or one that was in the background
    shown = Signal(object)  # `Result` to draw
    group_changed = Signal()  # Sensors were added or removed, or another one is chosen
    other_opened = Signal()  # A sensor that the panels do not show
    other_solved = Signal()
    failed = Signal(object)  # `Failed`, to be shown to the user
    compared = Signal(object, object)  # Compared settings, and the measurement of each

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self.state = state
        self.clients = [self._new_client()]  # Of the sensors that are open together
        self.chosen = 0  # Number of the one shown by the panels
        self.opening = Opening(state, lambda request: self.client.open(request))
        self.analysis = Analysis(state, lambda: self.client)
        self.player = Player(state)
        self._cold_solve_timer = QTimer(self, singleShot=True, interval=COLD_SOLVE_DELAY_MS)
        self._cold_solve_timer.timeout.connect(self.cold_solve)
        state.frame_changed.connect(self._on_frame)
        state.playing_changed.connect(self._on_playing)
        state.frozen_changed.connect(self._on_playing)
        state.settings_changed.connect(self._on_settings)

    @property
    def client(self) -> SensorClient:
        """The sensor shown by the panels."""
        return self.clients[self.chosen]

    @property
    def others(self) -> list[SensorClient]:
        """The other sensors that are open."""
        return [each for each in self.clients if each is not self.client and each.opened]

    @property
    def group(self) -> tuple[PlacedSensor, ...]:
        """The sensors that were opened together; empty: one alone."""
        return self.opening.group

    @property
    def worker(self) -> Worker:
        """Solver thread of the sensor shown by the panels."""
        return self.client.worker

    @property
    def result(self) -> Result:
        return self.client.result

    @property
    def inspection(self) -> Inspection:
        """Diagnostics of the frame shown."""
        return self.client.inspection

    @property
    def cold_solved(self) -> bool:
        """Whether no cold solve of the shown frame is due."""
        return self.state.advancing or self.client.cold_solved

    @property
    def dropped(self) -> int:
        """Frames skipped since the source was opened."""
        return self.player.skipped + self.client.dropped

    @property
    def sensor(self) -> Sensor | None:
        """The sensor in use; None before the first."""
        return self.opening.sensor

    def close(self) -> None:
        """Stop playback, and ask the solver threads to end."""
        self.player.close()
        self._cold_solve_timer.stop()
        for client in self.clients:
            client.close(0.0)

    def set_object(
        self,
        object_name: str | None,
        unit: Literal["m", "mm"] | None,
        start: np.ndarray | None,
        then: Callable[[RigidObject | None], None],
        failed: Callable[[Failed], None],
        *,
        fit: bool,
    ) -> None:
        """Register another object, or none; with `fit` at once, in the frame at the cursor."""
        client = self.client
        client.forget_pose()
        fitted = client.frame_job(self.state.frame, self._pose_demand) if fit else None

        def function() -> tuple[RigidObject | None, Solved | None]:
            obj = client.solver.set_object(object_name, unit, start)
            return obj, None if fitted is None else fitted[0]()

        def take(answer: tuple[RigidObject | None, Solved | None]) -> None:
            then(answer[0])
            if fitted is not None and answer[1] is not None:
                fitted[1](answer[1])

        def report(failure: Failed) -> None:
            failed(failure)
            client.failed.emit(failure)

        client.worker.submit(function, take, report, key="object")

    def compare(self, settings: tuple[ComparedOptions, ...]) -> None:
        """Measure two settings, or none, on the frame at the cursor while the solver is idle.

        Cold after the delay of a cold solve: not while scrubbing, nor while the panel is opened.
        """
        client, index, cold = self.client, self.state.frame, not self.state.advancing
        function = partial(client.solver.compare, index, settings, cold=cold)
        due_s = time.perf_counter() + 1e-3 * COLD_SOLVE_DELAY_MS if cold and settings else 0.0
        then = partial(self.compared.emit, settings)
        client.worker.submit(function, then, key="compare", due_s=due_s)

    def find_reference(self) -> None:
        """Search the contact-free reference images again."""
        demand = Demand.of(self.state.settings)
        self.client.request_frame(self.state.frame, demand, new_reference=True)

    def cold_solve(self) -> None:
        """Request the cold solve of the shown frame now instead of after the delay."""
        self._cold_solve_timer.stop()
        self.client.request_cold_solve()

    def choose(self, number: int) -> None:
        """Show a sensor of the group in the panels, unless a source is being opened there."""
        if self.opening.busy or self.clients[number] not in self.others:
            return
        playing, frozen = self.state.playing, self.state.frozen
        self.chosen = number
        self.group_changed.emit()
        self._present(playing=playing)
        self.state.freeze(frozen)
        self._request_frame()
        self.request_others()

    def set_extra_products(self, products: frozenset[Product]) -> None:
        """Set products that all sensors compute for publishing."""
        for client in self.clients:
            client.extra_products = products

    def regroup(self, group: tuple[PlacedSensor, ...] = ()) -> None:
        """Have solver threads for the sensors of a group, of which the first is being opened.

        Those of the others end by themselves.
        """
        first = self.client
        for client in self.clients:
            if client is not first:
                client.close(0.0)
        self.clients = [first, *(self._new_client() for _ in group[1:])]
        self.chosen, self.opening.group = 0, group
        first.name = ""
        for client, sensor in zip(self.clients, group, strict=False):
            client.name, client.extra_products = sensor.name, first.extra_products
        self.group_changed.emit()

    # -- the model changed --------------------------------------------------------------------

    def _on_frame(self, _: int, by_playback: bool) -> None:
        self._cold_solve_timer.stop()  # until the next frame is shown
        if not (by_playback and self.state.facts.grows):
            self._request_frame()
        if not (by_playback and self._follows):  # a live frame may arrive after a pause
            self.request_others()

    def _on_playing(self) -> None:
        """Playback or the view of a live source has stopped or resumed."""
        incomplete = bool(self.client.demand.images) or self.client.shown_thinned
        if not self.state.advancing and incomplete and self.cold_solved:
            self._request_frame()  # else the cold solve delivers them, with a single registration
        self._schedule_cold_solve()
        self._request_newest()
        self.request_others()

    def _on_settings(self, names: frozenset[str]) -> None:
        settings, sensor = self.state.settings, self.sensor
        demand = Demand.of(settings)
        estimator = names & {"solver", "compared"} and self.opening.options != settings.options
        if estimator and sensor is not None:
            self.opening.reopen(f"again, solver: {solver_title(settings.solver)}", lambda: sensor)
        elif (
            "cloud_points" in names
            or ("pose_track" in names and settings.pose_track)  # its poses may be outdated
            or not self.client.demand.covers(demand)
        ):
            restarted = self.analysis.busy and demand.flow != self.client.demand.flow
            self._request_frame()
            if restarted:
                self.analysis.start()
        elif names & PATCH_SETTINGS:
            self.client.request_patch()
        for other in self.others if names & PATCH_SETTINGS else ():
            other.history.forget_patches()
        self.request_others()

    # -- requests -----------------------------------------------------------------------------

    @property
    def _pose_demand(self) -> Demand:
        """Demand of the visible layers and panels, and the pose."""
        demand = Demand.of(self.state.settings)
        return replace(
            demand, products=demand.products | PATCH | pose_products(self.state.settings)
        )

    def _request_frame(self) -> None:
        """Request the frame at the cursor, unless another source is being opened."""
        if self.state.facts is self.client.facts:
            self._cold_solve_timer.stop()  # of the frame shown before
            self.client.request_frame(self.state.frame, Demand.of(self.state.settings))

    def _request_newest(self) -> None:
        """Request the newest frame of a live source, unless paused or frozen."""
        state = self.state
        if state.facts.grows and state.advancing:
            self.client.request_newest(Demand.of(state.settings))

    @property
    def _follows(self) -> bool:
        """Whether the newest frames of live sensors are shown."""
        return self.state.facts.grows and self.state.advancing

    def _follow_others(self) -> None:
        if self._follows:
            self.request_others()

    def request_others(self) -> None:
        """Request the newest frames of the other sensors, else those of the same time."""
        for other in self.others:
            if self._follows:
                other.request_newest(self._others_demand, at_once=True)
            else:
                other.request_frame(self._frame_of(other), self._others_demand)

    @property
    def _others_demand(self) -> Demand:
        """Demand of the layers in the view."""
        return Demand.of(replace(self.state.settings, panels=frozenset()))

    def _frame_of(self, other: SensorClient) -> int:
        """Frame of another sensor at the time of the cursor.

        Recordings made at the same time are aligned by their stamps, others by their first frames.
        """
        opened, shown, own_s = other.opened, self.result, self.state.facts.times_s
        if opened is None:
            return 0
        time_s = float(own_s[self.state.frame])
        if opened.request.source.stream is not None:
            return opened.request.source.stream.at(time_s)
        times_s = opened.facts.times_s
        later_s = _start_s(shown.frame) - _start_s(opened.result.frame)
        if -own_s[-1] < later_s < times_s[-1]:
            time_s += later_s
        return int(np.abs(times_s - time_s).argmin())

    # -- answers ------------------------------------------------------------------------------

    def _new_client(self) -> SensorClient:
        client = SensorClient(self.state)
        client.opened_source.connect(self._on_opened)
        client.solved.connect(self._on_solved)
        client.patched.connect(self._on_patched)
        client.paused.connect(self._on_paused)
        client.failed.connect(self._on_failed)
        return client

    @property
    def _is_other(self) -> bool:
        """Whether the signal is of a sensor that the panels do not show."""
        return self.sender() is not self.client

    def _on_patched(self, result: Result) -> None:
        if not self._is_other:
            self._show(result)

    def _on_failed(self, failed: Failed) -> None:
        if self._is_other:
            self.state.messages.add("error", failed.message, failed.details, topic=SOURCE)
            return
        self.opening.finish(failed.request, failed)
        if failed.key == "analyse":
            self.analysis.stop()
        self.failed.emit(failed)

    def _on_paused(self) -> None:
        if self._is_other:
            self._follow_others()
            return
        if self.client.images_outdated:
            self._request_frame()
        self._request_newest()

    def _on_solved(self, solved: Solved, newest: bool) -> None:
        """Request the next frame before drawing this one, which keeps the solver busy.

        That of another sensor at once: none waits for another. One requested during playback may
        arrive after a pause, and has another time then.
        """
        if self._is_other:
            if newest or self._follows:
                self.request_others()
            self.other_solved.emit()
            return
        if newest:
            self.state.grow(self.client.facts)
            self._request_newest()
        else:
            self.player.on_result(solved.result.frame.index)
        self._show(solved.result)
        if solved.demand.patch_rule != self.state.settings.patch_rule:
            self.client.request_patch()

    def _on_opened(self, opened: Opened) -> None:
        """Show the source, and open the other sensors of its group after it."""
        if self._is_other:
            self.other_opened.emit()
            self.request_others()
            return
        group = opened.request.group
        if group != self.group:
            self.regroup(group)
            first = replace(opened.request, frame=0, playing=True, demand=self._others_demand)
            for client, sensor in zip(self.clients[1:], group[1:], strict=True):
                request = replace(first, source=sensor.source, open_sensor=sensor.open_sensor)
                client.open(request)
        self._present(playing=opened.request.playing, replaces=True)
        self.opening.finish(opened.request)
        settings, requested = self.state.settings, opened.request.demand
        if not requested.covers(Demand.of(settings)):
            self._request_frame()
        elif requested.patch_rule != settings.patch_rule:
            self.client.request_patch()

    def _present(self, *, playing: bool, replaces: bool = False) -> None:
        """Show the newly opened source, or the other sensor."""
        client = self.client
        opened, facts, result = client.opened, client.facts, client.result
        if opened is None:
            raise RuntimeError("internal error: nothing is open")
        self.opening.current = opened
        self.analysis.stop()
        self.player.reset_to(result.frame.index)
        client.dropped = 0
        self.opened.emit(opened)
        if replaces:
            self.replaced.emit()
        self.state.set_playing(False)
        self.state.open(facts, result.frame.index, playing=playing, history=client.history)
        self._show(result)

    def _show(self, result: Result) -> None:
        """Draw a result if it belongs to the shown frame."""
        shown = self.client.result
        seen = shown.frame.index == result.frame.index
        if seen:
            self.state.shown_frame = result.frame.index
            self.state.final = self.state.facts.grows or self.client.cold_solved
        self.state.history_changed.emit()
        if seen:
            self.shown.emit(shown)
            self._follow_others()
        self._schedule_cold_solve()

    def _schedule_cold_solve(self) -> None:
        """Start the delay of the cold solve if one is due."""
        self._cold_solve_timer.stop() if self.cold_solved else self._cold_solve_timer.start()


def _start_s(frame: Frame) -> float:
    """Stamp of a source's first frame, s."""
    return 1e-9 * frame.stamp_ns - frame.time_s
