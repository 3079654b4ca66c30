"""Stiff and extreme cases: each solved within its tolerance, or refused with a reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from bubbleviz.errors import InputError, SolveError
from bubbleviz.study.isolated_process import Outcome, Worker

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


@dataclass(frozen=True)
class CaseResult:
    """Verdict on one case.

    Attributes
    ----------
    name : str
    verdict : {"passed", "refused", "failed"}
    detail : str
    ms : float
    """

    name: str
    verdict: Verdict
    detail: str
    ms: float


def attempt(case: Case) -> tuple[Verdict, str]:
    """Run a case here; only errors that are part of the contract are caught."""
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


def attempt_named(name: str) -> tuple[Verdict, str]:
    """Run the shipped case of that name (in a worker process)."""
    from bubbleviz.study.stability.stability_cases import all_cases

    return attempt(next(case for case in all_cases() if case.name == name))


def run_stability(
    cases: Sequence[Case], tick: Callable[[CaseResult], None] = lambda _: None
) -> list[CaseResult]:
    """Run shipped cases in a process of their own, each within its limit of time."""
    results = []
    with Worker() as worker:
        for case in cases:
            outcome = worker.call(attempt_named, case.name, limit_s=case.limit_s)
            result = _judged(case, outcome)
            results.append(result)
            tick(result)
    return results


def _judged(case: Case, outcome: Outcome) -> CaseResult:
    if outcome.kind == "returned":
        verdict, detail = outcome.value
        return CaseResult(case.name, verdict, detail, outcome.ms)
    return CaseResult(case.name, "failed", f"{outcome.kind}: {outcome.detail}", outcome.ms)


def summary(results: Sequence[CaseResult]) -> dict[str, Any]:
    """Counts and every case: what `study stability --json` prints."""
    verdicts = [result.verdict for result in results]
    return {
        "cases": len(results),
        "passed": verdicts.count("passed"),
        "refused": verdicts.count("refused"),
        "failed": verdicts.count("failed"),
        "results": [asdict(result) for result in results],
    }
