"""Progress reports of long computations, and how they are cancelled."""

from __future__ import annotations

from typing import Protocol


class Cancelled(Exception):  # noqa: N818 - no error: somebody asked for it
    """Raised by a `Progress` to stop a step; the step leaves nothing behind."""


class Progress(Protocol):
    """Called by a long step, often; it may raise `Cancelled`."""

    def __call__(self, step: str, done: float) -> None:
        """Step in plain words, and the share of it that is done, 0 … 1."""


def quiet(step: str, done: float) -> None:
    """Discard progress reports."""
