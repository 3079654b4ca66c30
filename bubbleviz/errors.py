"""Errors reported to the user in one sentence."""

from __future__ import annotations


class InputError(Exception):
    """Invalid file, message or argument.

    The message is one line with the file, the problem and the remedy. Commands print it and exit
    with code 2; the window shows it and keeps its state.
    """


class UnknownCameraError(InputError):
    """No sensor preset, or no single one, has a camera of this image size.

    Attributes
    ----------
    size : (int, int)
        Width and height of the images, pixels.
    """

    def __init__(self, message: str, size: tuple[int, int]) -> None:
        super().__init__(message)
        self.size = size


class StreamStoppedError(InputError):
    """A live source has stopped sending depth images without ending."""


class SolveError(Exception):
    """Valid input for which the solver found no trustworthy solution."""
