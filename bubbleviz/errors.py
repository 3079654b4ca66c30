"""Errors reported to the user in one sentence."""

from __future__ import annotations


class InputError(Exception):
    """Bad input from outside: a file, a message, an argument.

    The message is one line that names the file, what is wrong and what to do. Commands print
    it and exit with code 2; the window shows it and keeps what it had.
    """


class StreamStoppedError(InputError):
    """A live source sent depth images and sends no more, though it has not ended."""


class SolveError(Exception):
    """A well-formed problem that has no trustworthy answer (the status of the result says why)."""
