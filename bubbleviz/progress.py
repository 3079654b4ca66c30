"""Progress reports of long computations, and how they are cancelled."""

from __future__ import annotations

from typing import Protocol


class Cancelled(Exception):  # noqa: N818 - no error: requested by the user
    """Raised by a `Progress` to stop a step; the step leaves nothing behind."""


class Progress(Protocol):
    """Called by a long step, often; it may raise `Cancelled`."""

    def __call__(self, step: str, done: float) -> None:
        """Step in plain words, and the share of it that is done, 0 … 1."""


def part_of(whole: Progress, first: float, last: float) -> Progress:
    """Progress of a part of a task, as shares of the whole from `first` to `last`.

    Where the part begins anew, with a step of its own, the whole stays where it is.
    """
    reached = first

    def report(step: str, done: float) -> None:
        nonlocal reached
        reached = max(reached, first + (last - first) * done)
        whole(step, reached)

    return report


def quiet(step: str, done: float) -> None:
    """Discard progress reports."""
