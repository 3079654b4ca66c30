"""What runs and what it costs: each stage's time and count, and who asked for it. No Qt in here."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from statistics import median

from bubbleviz.pipeline import LOOKS, Product, stages
from bubbleviz.result import Result
from bubbleviz_ui.model.choices import Choices
from bubbleviz_ui.model.demand import plotted, products

STAGES = {
    "estimate": "Contact pressure (Eq. 23)",
    "fine_contact": "Contact on a finer mesh, where the camera is better than the sensor's",
    "patch": "Contact patch (section V-C of the paper)",
    "pixel_mask": "Pixels of the patch",
    "pose": "Pose of the object (section VI of the paper)",
    "cloud": "Measured points",
    "residual": "Residual of the range",
    "flow": "Optical flow of the colour image",
    "traction": "Traction with friction",
    "slip": "Slip",
    "texture": "Colour image on the membrane",
    "total": "Depth image in → products out",
}
"""What each stage of the pipeline computes."""
KEPT = 100
"""Frames that a median is of."""
ANALYSIS = "analysis of all frames"


@dataclass(frozen=True)
class Cost:
    """One line of the table.

    Attributes
    ----------
    stage : str
    title : str
        What it computes.
    last_ms, median_ms : float or None
        Time of the last frame it ran for, and median of the last hundred; None: never ran.
    runs : int
        How often it has run for the open source.
    why : tuple of str
        Layers and panels that ask for it now; empty: it does not run.
    """

    stage: str
    title: str
    last_ms: float | None
    median_ms: float | None
    runs: int
    why: tuple[str, ...]


class Costs:
    """Times of the frames that were computed last."""

    def __init__(self) -> None:
        self._times: dict[str, deque[float]] = {name: deque(maxlen=KEPT) for name in STAGES}
        self._seen: object = None

    def clear(self) -> None:
        """Begin anew for another source."""
        for times in self._times.values():
            times.clear()

    def take(self, result: Result) -> None:
        """Note the times of a frame, once."""
        if result.times_ms is self._seen:
            return  # the same frame with another patch
        self._seen = result.times_ms
        for stage, time_ms in result.times_ms.items():
            if stage in self._times:
                self._times[stage].append(time_ms)

    def table(
        self, choices: Choices, counts: Mapping[str, int], *, analysing: bool = False
    ) -> list[Cost]:
        """Every stage, whether it runs or not."""
        asked = who_asks(choices, analysing=analysing)
        lines = []
        for stage, title in STAGES.items():
            times = self._times[stage]
            lines.append(
                Cost(
                    stage,
                    title,
                    times[-1] if times else None,
                    median(times) if times else None,
                    counts.get(stage, 0),
                    () if stage == "total" else tuple(asked.get(stage, ())),
                )
            )
        return lines


def who_asks(choices: Choices, *, analysing: bool = False) -> dict[str, list[str]]:
    """Layers and panels by the stages that run because of them."""
    nothing = replace(choices, layers=frozenset(), panels=frozenset())
    asked: dict[str, list[str]] = {}

    def note(name: str, needed: Iterable[Product]) -> None:
        for stage in stages(frozenset(needed)) - LOOKS.keys():
            asked.setdefault(stage, []).append(name)

    for name in sorted(choices.layers):
        note(name, products(replace(nothing, layers=frozenset({name}))))
    for name in sorted(choices.panels):
        note(name, products(replace(nothing, panels=frozenset({name}))))
    if analysing:
        note(ANALYSIS, plotted(choices))
    return asked
