"""Playback time without a screen and without waiting."""

from __future__ import annotations

import numpy as np
import pytest

from bubbleviz_ui.playback.play_clock import PlayClock

TIMES = np.arange(10) / 10.0


@pytest.fixture
def clock() -> PlayClock:
    made = PlayClock(TIMES + 5.0)
    made.start(2, wall_s=100.0, speed=1.0)
    return made


def test_frames_come_due_in_time(clock: PlayClock) -> None:
    assert clock.due(100.05, loop=True) == (2, 0, False)
    assert clock.due(100.1, loop=True) == (3, 0, False)


def test_late_looks_count_what_they_skip(clock: PlayClock) -> None:
    assert clock.due(100.4, loop=True) == (6, 3, False)


@pytest.mark.parametrize("speed", [0.1, 0.5, 2.0, 8.0])
def test_speed(speed: float) -> None:
    clock = PlayClock(TIMES)
    clock.start(0, wall_s=0.0, speed=speed)
    assert clock.due(0.5 / speed, loop=False)[0] == 5


def test_the_end_without_a_loop(clock: PlayClock) -> None:
    assert clock.due(100.7, loop=False) == (9, 6, True)


def test_a_loop_begins_one_interval_after_the_last_frame(clock: PlayClock) -> None:
    assert clock.due(100.75, loop=True)[0] == 9
    assert clock.due(100.85, loop=True) == (0, 0, False)
    assert clock.due(100.95, loop=True) == (1, 0, False)


def test_several_turns_at_once(clock: PlayClock) -> None:
    index, skipped, ended = clock.due(102.85, loop=True)
    assert (index, skipped, ended) == (0, 27, False)


def test_a_single_frame_plays_without_harm() -> None:
    clock = PlayClock(np.zeros(1))
    clock.start(0, wall_s=0.0, speed=1.0)
    assert clock.due(0.5, loop=True)[0] == 0
    assert clock.due(0.5, loop=False) == (0, 0, True)


def test_uneven_times() -> None:
    clock = PlayClock(np.array([0.0, 0.1, 1.0]))
    clock.start(0, wall_s=0.0, speed=1.0)
    assert clock.due(0.9, loop=True)[0] == 1
