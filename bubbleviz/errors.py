"""Errors reported to the user in one sentence."""

from __future__ import annotations


class InputError(Exception):
    """Invalid file, message or argument.

    The message is one line with the file, the problem and the remedy. Commands print it and exit
    with code 2; the window shows it and keeps its state.
    """


class StreamStoppedError(InputError):
    """A live source has stopped sending depth images without ending."""


class SolveError(Exception):
    """Valid input for which the solver found no trustworthy solution."""
