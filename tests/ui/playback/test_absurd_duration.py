"""A recording with a stamp of the far future is drawn like any other."""

import numpy as np
import pytest
from PySide6.QtGui import QPainter

from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts
from bubbleviz_ui.playback.timeline import Timeline


@pytest.mark.timeout(60)
def test_absurd_duration_is_drawn_with_a_few_time_labels(qtbot, monkeypatch):
    state, drawn = SessionState(), []
    state.open(SourceFacts("broken stamps", "dome", np.array([0.0, 0.1, 6e10])), playing=False)
    timeline = Timeline(state)
    timeline.resize(900, timeline.height())

    monkeypatch.setattr(QPainter, "drawText", lambda painter, place, text: drawn.append(text))
    timeline.grab()
    assert 1 < len(drawn) < 20
