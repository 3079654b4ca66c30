"""A case of the stability study: what is to be solved or refused, and the verdict on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from bubbleviz.errors import InputError, SolveError

Verdict = Literal["passed", "refused", "failed"]


class RefusedError(Exception):
    """The program declined to answer, by a status that says why."""


class FailedError(Exception):
    """A wrong answer was given as a right one."""


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes
    ----------
    name : str
    run : callable
        Returns what was found in words. Raises `FailedError` for a wrong answer; `RefusedError`,
        InputError or SolveError where the program refuses.
    must : {"solve", "refuse", "either"}
        What is right: an ordinary problem may not be refused, nor nonsense be answered.
    limit_s : float
        Longer is a hang.
    quick : bool
        Part of the quick form.
    """

    name: str
    run: Callable[[], str]
    must: Literal["solve", "refuse", "either"] = "either"
    limit_s: float = 120.0
    quick: bool = False


def attempt(case: Case) -> tuple[Verdict, str]:
    """Run a case here; only errors the API documents are caught."""
    verdict: Verdict = "passed"
    try:
        detail = case.run()
    except FailedError as error:
        return "failed", str(error)
    except (RefusedError, InputError, SolveError) as error:
        verdict, detail = "refused", str(error) or type(error).__name__
    if case.must == "solve" and verdict == "refused":
        return "failed", f"refused what it must solve: {detail}"
    if case.must == "refuse" and verdict == "passed":
        return "failed", f"answered what it must refuse: {detail}"
    return verdict, detail
