"""Latest request wins; nothing queues up; errors come back as answers."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from threading import Event, Thread

import pytest
from fakes import DentSource
from pytestqt.qtbot import QtBot

from bubbleviz.calibration.pressure_zero import PressureZero
from bubbleviz.live.sources.open_stream import open_stream
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.request_slots import RequestSlots
from bubbleviz_ui.engine.requests import (
    Answer,
    Failed,
    FrameRequest,
    NewestRequest,
    Opened,
    OpenRequest,
    PatchRequest,
    Request,
    SettleRequest,
    Solved,
    Waited,
)
from bubbleviz_ui.engine.solver_server import Server
from bubbleviz_ui.engine.solver_thread import Worker
from bubbleviz_ui.live.live_frames import LiveFrames, LiveOpener
from bubbleviz_ui.model.demand import Demand

CLOUD = Demand(frozenset({"cloud"}))


def frame(index: int = 0, session: int = 1) -> FrameRequest:
    return FrameRequest(session, CLOUD, index)


def opening(sensor: Sensor, session: int = 1, at: int = 0) -> OpenRequest:
    return OpenRequest(session, "dent", DentSource, lambda: sensor, at, CLOUD)


def test_one_slot_a_kind(sensor: Sensor) -> None:
    slots = RequestSlots()
    assert slots.put(frame(1)) is None
    assert slots.put(frame(2)) == frame(1)
    slots.put(SettleRequest(1, frame(2).demand, 2))
    slots.put(frame(3))  # what was left is not settled any more
    request = opening(sensor)
    slots.put(request)
    assert slots.take() is request
    assert slots.take() == frame(3)
    slots.close()
    assert slots.take() is None


def test_what_is_not_due_yet_keeps_nothing_waiting_that_goes_before_it(sensor: Sensor) -> None:
    """A drag of κ is answered although the next live frame is not to be taken yet."""
    slots, opened = RequestSlots(), Server().serve(opening(sensor))
    assert isinstance(opened, Opened)
    newest = NewestRequest(1, CLOUD, time.perf_counter() + 1e6)
    patch = PatchRequest(1, CLOUD, opened.result)
    slots.put(newest)
    slots.put(SettleRequest(1, CLOUD, 2))
    taken: list[Request | None] = []
    taker = Thread(target=lambda: taken.extend((slots.take(), slots.take(), slots.take())))
    taker.start()
    slots.put(patch)
    slots.put(replace(newest, from_s=0.0))
    taker.join(240.0)
    assert taken == [patch, replace(newest, from_s=0.0), SettleRequest(1, CLOUD, 2)]


def test_a_wait_that_was_called_off_is_no_pause_of_the_source(sensor: Sensor) -> None:
    server, stream = Server(), open_stream("synthetic:?rate=100&frames=2", sensor)
    frames = LiveFrames("press", stream, PressureZero(sensor.pneumatics.reference_pressure_pa))
    with stream:
        while not frames.came(60.0):
            pass
        frames.begin(frames.first_ns)
    opened = server.serve(OpenRequest(1, "press", LiveOpener(frames), lambda: sensor, 0, CLOUD))
    assert isinstance(opened, Opened)
    newest = NewestRequest(1, CLOUD)
    while isinstance(server.serve(newest), Solved):  # what had arrived before it ended
        pass
    server.wait_no_longer()
    assert server.serve(newest) == Waited(newest, paused=False)
    assert server.serve(newest) == Waited(newest, paused=True)
    server.close()


def test_server_opens_and_solves(sensor: Sensor) -> None:
    server = Server()
    assert server.serve(frame(1)) is None
    opened = server.serve(opening(sensor, at=99))
    assert isinstance(opened, Opened) and opened.frame == opened.facts.frames - 1
    solved = server.serve(frame(3))
    assert isinstance(solved, Solved) and solved.result.frame.index == 3
    assert solved.result.estimate is None
    server.close()


def test_requests_of_a_session_that_is_gone_are_not_served(sensor: Sensor) -> None:
    server = Server()
    server.serve(opening(sensor, session=1))
    server.serve(opening(sensor, session=2))
    assert server.serve(frame(1, session=1)) is None
    assert isinstance(server.serve(frame(2, session=2)), Solved)


def test_a_failed_opening_keeps_the_open_source(sensor: Sensor) -> None:
    server = Server()
    server.serve(opening(sensor))
    request = OpenRequest(2, "x", _no_source, lambda: sensor, 0, CLOUD)
    failed = server.serve(request)
    assert isinstance(failed, Failed) and "ValueError: no" in failed.message
    assert isinstance(server.serve(frame(1)), Solved)


def _no_source(sensor: Sensor) -> DentSource:
    raise ValueError("no")


class Held(Server):
    """Serves nothing until it is let go."""

    def __init__(self) -> None:
        super().__init__()
        self.begun, self.go = Event(), Event()
        self.served: list[Request] = []

    def serve(self, request: Request) -> Answer | None:
        self.begun.set()
        self.go.wait(20)
        self.served.append(request)
        return Failed(request, "held", "")


@pytest.fixture
def held() -> Iterator[tuple[Worker, Held]]:
    server = Held()
    worker = Worker(server)
    yield worker, server
    server.go.set()
    worker.close()


def test_frames_asked_for_meanwhile_are_dropped(qtbot: QtBot, held: tuple[Worker, Held]) -> None:
    worker, server = held
    answers: list[Answer] = []
    worker.answered.connect(answers.append)
    worker.ask(frame(1))
    assert server.begun.wait(20)
    for number in range(2, 6):
        worker.ask(frame(number))
    server.go.set()
    qtbot.waitUntil(lambda: len(answers) == 2, timeout=240_000)
    assert [r.index for r in server.served if isinstance(r, FrameRequest)] == [1, 5]
    assert worker.dropped == 3


def test_what_closing_did_not_wait_for_is_waited_for_before_the_end(sensor: Sensor) -> None:
    begun, release, ended = Event(), Event(), Event()

    class Slow(Server):
        def serve(self, request: Request) -> Answer | None:
            begun.set()
            release.wait(240.0)
            return super().serve(request)

        def close(self) -> None:
            super().close()
            ended.set()

    worker = Worker(Slow())
    worker.ask(opening(sensor))
    assert begun.wait(240.0)
    worker.close(timeout_s=0.0)
    assert not ended.is_set()
    release.set()
    worker.wait(240.0)
    assert ended.is_set()
