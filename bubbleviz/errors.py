"""Errors reported to the user in one sentence."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, nan
from numbers import Integral, Real
from os import PathLike
from pathlib import Path


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


# Checks of arguments that the command line makes of its options, for callers from Python.


def check_type(argument: str, value: object, *types: type) -> None:
    """Refuse what is of none of the types. Raises InputError."""
    if not isinstance(value, types):
        names = " or ".join(each.__name__ for each in types)
        raise InputError(f"{argument}: expected {names}, not {type(value).__name__}")


def given_path(argument: str, value: object) -> Path:
    """Path of an argument. Raises InputError: it is none, or empty, which is the current folder."""
    check_type(argument, value, str, PathLike)
    if value == "":
        raise InputError(f"{argument}: the path is empty; give one")
    return Path(value)  # type: ignore[arg-type]


def check_number(
    option: str, value: object, lowest: float, highest: float = inf, *, whole: bool = False
) -> None:
    """Refuse what is not a finite or whole number from `lowest` to `highest`. Raises InputError."""
    is_number = isinstance(value, Integral if whole else Real) and not isinstance(value, bool)
    number = float(value) if is_number else nan  # type: ignore[arg-type]
    if not lowest <= number <= highest or number == inf:
        limits = f"from {lowest:g} to {highest:g}" if highest < inf else f"of {lowest:g} or more"
        kind = "whole" if whole else "finite"
        raise InputError(f"{option} {value}: give a {kind} number {limits}")


def check_given(option: str, value: object, *limits: float, whole: bool = False) -> None:
    """As `check_number`, for an option that may be None. Raises InputError."""
    if value is not None:
        check_number(option, value, *limits, whole=whole)


def check_choice(option: str, value: object, choices: Iterable[object]) -> None:
    """Refuse what is not one of the choices. Raises InputError."""
    if value not in (known := tuple(choices)):
        raise InputError(f"{option} {value}: choose one of {', '.join(map(str, known))}")
