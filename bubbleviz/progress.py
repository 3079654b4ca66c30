"""Progress reports and cancellation of long computations."""

from __future__ import annotations

from typing import Protocol


class Cancelled(Exception):  # noqa: N818 - no error: requested by the user
    """Raised by a `Progress` to stop a computation, which then leaves no partial results."""


class Progress(Protocol):
    """Called repeatedly by a long computation; may raise `Cancelled`."""

    def __call__(self, step: str, done: float) -> None:
        """Name of the step, and its completed share, 0 … 1."""


def part_of(task: Progress, first: float, last: float) -> Progress:
    """Progress of a part of a task that takes its shares from `first` to `last`.

    The share of the task never decreases, even if the part starts several steps.
    """
    furthest = first

    def report(step: str, done: float) -> None:
        nonlocal furthest
        furthest = max(furthest, first + (last - first) * done)
        task(step, furthest)

    return report


def quiet(step: str, done: float) -> None:
    """Discard progress reports."""
