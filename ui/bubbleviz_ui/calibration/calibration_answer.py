"""What the calibration thread hands to the window: a draft and the pictures it needs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.calibration.draft import Draft, Settings
from bubbleviz.calibration.rest.collected_frames import CollectedFrames
from bubbleviz.frames.gaps import TimeAxis
from bubbleviz.progress import Progress, part_of
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.units import Units

if TYPE_CHECKING:
    from bubbleviz.calibration.reports.pixel_images import BeforeAfter
    from bubbleviz.calibration.reports.verdict import Verdict
    from bubbleviz.calibration.sensor_comparison import Comparison
    from bubbleviz.calibration.workbench import Workbench

PICTURES = 0.95
"""Share of the work that is done before the pictures of it are made."""


@dataclass(frozen=True)
class Work:
    """All that a person decided; undo puts an older one back.

    Attributes
    ----------
    settings : Settings
    collected : CollectedFrames or None
        Frames of a live source; None: the recording itself.
    """

    settings: Settings = field(default_factory=Settings)
    collected: CollectedFrames | None = None


@dataclass(frozen=True)
class Answer:
    """What came of it.

    Attributes
    ----------
    work : Work
    draft : Draft
    axis : TimeAxis
        Where the frames of the source lie on the timeline.
    last : BeforeAfter or None
    local_tension : (H, W) array or None
        N/m.
    comparison : Comparison or None
        Against the sensor that was in use.
    compared_with : Sensor or None
    """

    work: Work
    draft: Draft
    axis: TimeAxis = field(default_factory=lambda: TimeAxis(np.zeros(0)))
    last: BeforeAfter | None = None
    local_tension: np.ndarray | None = None
    comparison: Comparison | None = None
    compared_with: Sensor | None = None

    @property
    def frames(self) -> int:
        """Count the frames of the source."""
        return len(self.axis)

    def verdict(self, units: Units) -> Verdict | None:
        """What the identification is worth, in the operator's units; None before there is one."""
        if self.draft.found is None:
            return None
        from bubbleviz.calibration.reports.verdict import judge  # the window starts without

        return judge(self.draft.found, units.gas_pressure.text)


def answer(bench: Workbench, work: Work, in_use: Sensor, progress: Progress) -> Answer:
    """Do the work and everything that is shown of it; runs in the calibration thread."""
    draft = bench.work(work.settings, part_of(progress, 0.0, PICTURES))
    axis = TimeAxis(bench.source.times_s)
    if draft.found is None:
        return Answer(work, draft, axis)
    progress("pictures", PICTURES)
    # the window starts without
    from bubbleviz.calibration.reports.pixel_images import before_after, local_tension_image
    from bubbleviz.calibration.sensor_comparison import compare

    return Answer(
        work,
        draft,
        axis,
        last=before_after(draft.found),
        local_tension=local_tension_image(draft.found),
        comparison=compare(in_use, draft.found),
        compared_with=in_use,
    )
