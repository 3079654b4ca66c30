"""Between model and solver thread: decides what is asked for and when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from PySide6.QtCore import QObject, QTimer, Signal

from bubbleviz.diagnostics import Inspection, Numbers
from bubbleviz.pipeline import FrameOptions, Product
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.opening import Opening
from bubbleviz_ui.engine.sensor_client import SensorClient
from bubbleviz_ui.engine.solver import ComparedOptions, Opened, Solved
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.model.demand import Demand, plot_products, pose_products
from bubbleviz_ui.model.registry import PATCH
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import PATCH_SETTINGS, solver_title
from bubbleviz_ui.playback.player import Player

# Analysis of all frames, while the solver has nothing else to do.


class Analysis(QObject):
    """Has the numbers computed that are not known yet, a part of the frames at a time.

    `state`: Remembers the numbers.
    `client`: Gives the sensor whose frames are analysed.
    """

    progressed = Signal(int, int)  # Frames done and frames asked for; equal when it is over

    def __init__(self, state: SessionState, client: Callable[[], SensorClient]) -> None:
        super().__init__()
        self._state, self._client = state, client
        self._frames: tuple[int, ...] = ()
        self._products: frozenset[Product] = frozenset()
        self._count, self._kept_only = 0, False
        state.settings_changed.connect(self._on_settings)

    @property
    def busy(self) -> bool:
        """It goes on."""
        return bool(self._frames)

    def start(self) -> None:
        """Compute what the chosen plots need and is not known yet, of all frames."""
        products = plot_products(self._state.settings)
        self._begin(products, self._state.history.missing(products), kept_only=False)

    def _find_patches_again(self) -> None:
        """Find those that another κ has made untrue, of estimates that are kept."""
        if self.busy and not self._kept_only:
            self.start()
        else:
            self._begin(frozenset({"patch"}), self._state.history.outdated, kept_only=True)

    def stop(self) -> None:
        """Leave the rest; what was computed stays."""
        self._frames, self._count = (), 0
        self.progressed.emit(0, 0)

    def _take(self, frames: tuple[int, ...], demand: Demand, numbers: list[Numbers | None]) -> None:
        """Remember numbers of the first frames, and ask for the others."""
        same = demand.patch_rule == self._state.settings.patch_rule
        known = {k: each for k, each in zip(frames, numbers, strict=False) if each}
        self._state.remember(tuple(known), tuple(known.values()), same_patch=same)
        if frames is self._frames:
            self._frames = frames[len(numbers) :]
            self._ask_rest()

    def _on_settings(self, names: frozenset[str]) -> None:
        if names & PATCH_SETTINGS:
            self._find_patches_again()

    def _begin(self, products: frozenset[Product], frames: np.ndarray, *, kept_only: bool) -> None:
        self._products, self._kept_only = products, kept_only
        self._frames = tuple(int(k) for k in frames)
        self._count = len(self._frames)
        self._ask_rest()

    def _ask_rest(self) -> None:
        self.progressed.emit(self._count - len(self._frames), self._count)
        if self._frames:
            settings = self._state.settings
            options = FrameOptions(*settings.patch_rule)
            demand = Demand(self._products, options=options, shear=Demand.of(settings).shear)
            frames, client = self._frames, self._client()
            function = partial(client.solver.analyse, frames, demand, kept_only=self._kept_only)
            client.worker.submit(function, partial(self._take, frames, demand), key="analyse")


@dataclass(frozen=True)
class Followed:
    """The object that is looked for now, if it could be loaded; `fitted`: at once, to a frame."""

    object_name: str | None
    unit: Literal["m", "mm"] | None
    fitted: bool
    obj: RigidObject | None = None


STANDS_MS = 150
"""How long one has to stay at a frame before it is settled: not while scrubbing."""


class Controller(QObject):
    """Asks for what the visible things need of the frame at the cursor."""

    opened = Signal(object)  # An `Opened`: another source or sensor is open
    shown = Signal(object)  # A `Result` to draw
    failed = Signal(object)  # A `Failed` to tell the user about
    compared = Signal(object, object)  # Settings, and what was measured with each on one frame
    followed = Signal(object)  # A `Followed`: another object is looked for, or none

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self.state = state
        self.client = SensorClient(state)  # The sensor that the panels show
        # Opens other things
        self.opening = Opening(state, lambda request: self.client.open(request))
        self.analysis = Analysis(state, lambda: self.client)  # Of all frames
        self.player = Player(state)  # Of recordings
        self._stands = QTimer(self, singleShot=True, interval=STANDS_MS)
        self._stands.timeout.connect(self.settle)
        self._listen(self.client)
        state.frame_changed.connect(self._on_frame)
        state.playing_changed.connect(self._on_playing)
        state.frozen_changed.connect(self._on_frozen)
        state.settings_changed.connect(self._on_settings)

    @property
    def worker(self) -> Worker:
        """Solver thread of the sensor that the panels show."""
        return self.client.worker

    @property
    def result(self) -> Result | None:
        """What is shown; None before the first source."""
        return self.client.result

    @property
    def inspection(self) -> Inspection:
        """Closer look at the frame that is shown."""
        return self.client.inspection

    @property
    def settled(self) -> bool:
        """Whether nothing is to be settled of what is shown: it goes on, or is settled."""
        return self._goes_on or self.client.result is None or self.client.settled

    @property
    def dropped(self) -> int:
        """Frames left out on purpose since the source was opened."""
        return self.player.skipped + self.client.dropped

    @property
    def sensor(self) -> Sensor | None:
        """The sensor in use; None before the first."""
        return self.opening.sensor

    def close(self) -> None:
        """Stop playback and the solver thread."""
        self.player.close()
        self._stands.stop()
        self.worker.close()

    def follow(
        self,
        object_name: str | None,
        unit: Literal["m", "mm"] | None,
        start: np.ndarray | None,
        *,
        fit: bool,
    ) -> None:
        """Look for another object, or for none; `fit` it to the frame at the cursor at once."""
        if self.state.facts is None:
            return
        client, request = self.client, Followed(object_name, unit, fit)
        fitted = client.framing(self.state.frame, self._pose_demand) if fit else None

        def function() -> tuple[RigidObject | None, Solved | None]:
            obj = client.solver.follow(object_name, unit, start)
            return obj, None if fitted is None else fitted[0]()

        def then(answer: tuple[RigidObject | None, Solved | None]) -> None:
            self.followed.emit(replace(request, obj=answer[0]))
            if fitted is not None and answer[1] is not None:
                fitted[1](answer[1])

        client.worker.submit(function, then, key="follow", request=request)

    def compare(self, settings: tuple[ComparedOptions, ...]) -> None:
        """Measure two settings, or none, on the frame at the cursor, in spare time."""
        client, index, stands = self.client, self.state.frame, not self._goes_on
        function = partial(client.solver.compare, index, settings, settled=stands)
        client.worker.submit(function, partial(self.compared.emit, settings), key="compare")

    def collect(self) -> None:
        """Find the contact-free colour images anew."""
        if self.state.facts is not None:
            self.client.ask_frame(self.state.frame, Demand.of(self.state.settings), anew=True)

    def settle(self) -> None:
        """Have the frame that is shown settled now; it is once one has stayed at it, too."""
        self._stands.stop()
        self.client.ask_settled()

    def turn_to(self, client: SensorClient) -> SensorClient:
        """Have the panels show the other sensor of a session; gives back the one they showed."""
        before, self.client = self.client, client
        playing, frozen = self.state.playing, self.state.frozen
        self._listen(before, on=False)
        self._listen(client)
        self._present(playing=playing)
        self.state.freeze(frozen)
        self._ask_frame()
        return before

    # -- the model changed --------------------------------------------------------------------

    def _on_frame(self, _: int, by_playback: bool) -> None:
        self._stands.stop()  # until the next frame is shown
        if not (by_playback and self._grows):
            self._ask_frame()

    def _on_playing(self, playing: bool) -> None:
        left_out = bool(self.client.demand.diagnostics) or self.client.shown_thinned
        if not playing and left_out and self.settled:
            self._ask_frame()  # else they come with what is settled, and the pose is found once
        self._wait_to_settle()
        self._ask_newest()

    def _on_frozen(self, frozen: bool) -> None:
        left_out = self.client.look_is_old or self.client.shown_thinned
        if frozen and left_out and self.settled:
            self._ask_frame()
        self._wait_to_settle()
        self._ask_newest()

    def _on_settings(self, names: frozenset[str]) -> None:
        settings, sensor = self.state.settings, self.sensor
        estimator = names & {"solver", "compared"} and self.opening.options != settings.options
        if estimator and sensor is not None:
            self.opening.reopen(f"solver: {solver_title(settings.solver)}", lambda: sensor)
        elif (
            "cloud_points" in names
            or ("pose_track" in names and settings.pose_track)  # its poses may be outdated
            or not self.client.demand.covers(Demand.of(settings))
        ):
            self._ask_frame()
        elif names & PATCH_SETTINGS:
            self.client.ask_patch()

    # -- requests -----------------------------------------------------------------------------

    @property
    def _goes_on(self) -> bool:
        """Whether other frames come by themselves."""
        return self.state.playing and not self.state.frozen

    @property
    def _pose_demand(self) -> Demand:
        """What is visible, and the pose."""
        demand = Demand.of(self.state.settings)
        return replace(
            demand, products=demand.products | PATCH | pose_products(self.state.settings)
        )

    @property
    def _grows(self) -> bool:
        return self.state.facts is not None and self.state.facts.grows

    def _ask_frame(self) -> None:
        """Ask for the frame at the cursor, unless another source is just being taken."""
        if self.state.facts is not None and self.state.facts is self.client.facts:
            self.client.ask_frame(self.state.frame, Demand.of(self.state.settings))

    def _ask_newest(self) -> None:
        """Ask for the newest frame of a live source, unless nobody wants it now."""
        state = self.state
        if self._grows and state.playing and not state.frozen:
            self.client.ask_newest(Demand.of(state.settings))

    # -- answers ------------------------------------------------------------------------------

    def _listen(self, client: SensorClient, *, on: bool = True) -> None:
        for signal, slot in (
            (client.turned, self._on_opened),
            (client.solved, self._on_solved),
            (client.patched, self._show),
            (client.paused, self._on_paused),
            (client.failed, self._on_failed),
        ):
            signal.connect(slot) if on else signal.disconnect(slot)

    def _on_failed(self, failed: Failed) -> None:
        self.opening.take(failed.request)
        if failed.key == "analyse":
            self.analysis.stop()
        self.failed.emit(failed)

    def _on_paused(self) -> None:
        if self.client.look_is_old:
            self._ask_frame()
        self._ask_newest()

    def _on_solved(self, solved: Solved, newest: bool) -> None:
        """Ask for what comes next before this is drawn, so that the solver has work meanwhile."""
        if newest and self.client.facts is not None:
            self.state.grow(self.client.facts)
            self._ask_newest()
        else:
            self.player.came(solved.result.frame.index)
        self._show(solved.result)
        if solved.demand.patch_rule != self.state.settings.patch_rule:
            self.client.ask_patch()

    def _on_opened(self, opened: Opened) -> None:
        self.opening.take(opened.request)
        self._present(playing=opened.request.playing)
        settings, asked = self.state.settings, opened.request.demand
        if not asked.covers(Demand.of(settings)):
            self._ask_frame()
        elif asked.patch_rule != settings.patch_rule:
            self.client.ask_patch()

    def _present(self, *, playing: bool) -> None:
        """Show what is open now: another source, or the other sensor."""
        client = self.client
        opened, facts, result = client.opened, client.facts, client.result
        if opened is None or facts is None or result is None:
            raise RuntimeError("nothing is open yet")
        self.opening.present = opened
        self.analysis.stop()
        self.player.turn_to(result.frame.index)
        client.dropped = 0
        self.opened.emit(opened)
        self.state.set_playing(False)
        self.state.open(facts, result.frame.index, playing=playing, history=client.history)
        self._show(result)

    def _show(self, result: Result) -> None:
        """Draw a result that came, if the client shows it."""
        shown = self.client.result
        seen = shown is not None and shown.frame.index == result.frame.index
        if seen:
            self.state.shown_frame = result.frame.index
        self.state.history_changed.emit()
        if seen:
            self.shown.emit(shown)
        self._wait_to_settle()

    def _wait_to_settle(self) -> None:
        """Have the frame that is shown settled, once one has stayed at it for a moment."""
        self._stands.stop() if self.settled else self._stands.start()
