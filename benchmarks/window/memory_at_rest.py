"""Memory of an idle window in a fixed state.

Results of calibrations and caches remain; two measurements may differ by 250 MiB.
"""

from __future__ import annotations

import gc
from dataclasses import fields
from typing import TYPE_CHECKING

from benchmarks.window.replay_rate import run_for
from bubbleviz.calibration import Step
from bubbleviz_ui.engine.upkeep import release_memory, resident_mib
from bubbleviz_ui.shell.dock import Dock

if TYPE_CHECKING:
    from bubbleviz_ui.window_session import WindowSession

GLANCE_S = 0.5  # how long each panel is shown
CALIBRATION_S = 30.0  # longest wait for a calibration; refused ones end sooner
REST_S = 1.5  # s without input before memory is read
OBJECT = "hex_nut"


class Rest:
    """Closes everything in a window, and opens all of it once."""

    def __init__(
        self,
        session: WindowSession,  # its current state is the rest state
    ) -> None:
        self._session = session
        self._choices, self._panels = session.state.settings, session.window.open_panels

    def tour(self) -> None:
        """Open every panel, search for an object and calibrate, so that everything is loaded."""
        window, state = self._session.window, self._session.state
        for panel in window.panels.values():
            if isinstance(panel, Dock):
                panel.setVisible(True)
                run_for(GLANCE_S)
        state.change(pose_object=OBJECT, pose_track=True, membrane_opacity=0.5)
        calibration = window.calibration.calibration
        calibration.reach(Step.TENSION, "calibrate")
        for _ in range(round(CALIBRATION_S / GLANCE_S)):
            run_for(GLANCE_S)
            if not calibration.busy:
                break

    def memory_mib(self) -> float:
        """Close everything, wait, and return the resident memory of this process."""
        window, state = self._session.window, self._session.state
        calibration = window.calibration.calibration
        calibration.cancel()
        calibration.start(lambda _: None, lambda _: None)  # after what was cancelled has ended
        while calibration.busy:
            run_for(GLANCE_S)
        with window.undo_recorder.unrecorded():
            window.show_only(self._panels)
            state.change(**{f.name: getattr(self._choices, f.name) for f in fields(self._choices)})
        state.set_range(None)
        state.set_playing(False)
        run_for(REST_S)
        gc.collect()
        release_memory()
        return resident_mib()
