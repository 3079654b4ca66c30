"""Session state: signals only for actual changes."""

import numpy as np
import pytest

from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts


def test_cursor_is_clamped_and_stepping_pauses():
    state = SessionState()
    state.seek(3)  # nothing moves before a source is open
    state.set_playing(True)
    assert state.frame == 0 and not state.playing
    state.open(SourceFacts("press", "dome", np.arange(10) / 20.0), playing=False)
    events: list[tuple[object, ...]] = []
    state.frame_changed.connect(lambda *frame: events.append(("frame", *frame)))
    state.playing_changed.connect(lambda playing: events.append(("playing", playing)))
    state.seek(99)
    state.seek(-5)
    state.seek(0)
    assert events == [("frame", 9, False), ("frame", 0, False)]
    state.set_playing(True)
    state.step(2)
    assert events[2:] == [("playing", True), ("playing", False), ("frame", 2, False)]
    state.change(loop=False)
    state.seek(9)
    state.set_playing(True)  # restarts at the first frame
    assert state.frame == 0
    state.open(SourceFacts("image", "dome", np.zeros(1)), playing=True)
    assert not state.playing  # a single frame would be solved again and again


def test_frame_rate_of_a_source():
    assert SourceFacts("", "", np.arange(11) / 20.0).rate_hz == pytest.approx(20.0)
    assert np.isnan(SourceFacts("", "", np.zeros(1)).rate_hz)
