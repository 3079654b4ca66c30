"""Stiff and extreme cases, each solved within its tolerance, or refused with a reason."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

from bubbleviz.errors import InputError, SolveError
from bubbleviz.study import harness, stability_cases
from bubbleviz.study.harness import Report, Study
from bubbleviz.study.stability_trial import Case, FailedError, RefusedError

Verdict = Literal["passed", "refused", "failed"]


@dataclass(frozen=True)
class CaseResult:
    """Verdict on one case, in how long, and what was found or why not."""

    name: str
    verdict: Verdict
    detail: str
    ms: float


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


def attempt_named(name: str) -> list[CaseResult]:
    """Run the shipped case of that name (in a worker process)."""
    start = time.perf_counter()
    verdict, detail = attempt(next(c for c in stability_cases.all_cases() if c.name == name))
    return [CaseResult(name, verdict, detail, 1e3 * (time.perf_counter() - start))]


def stability_study(pattern: str = "", *, quick: bool = False) -> Study:
    """Shipped cases with a pattern in their name, each within its limit of time.

    Raises InputError: there is none.
    """
    chosen = [c for c in stability_cases.all_cases() if pattern in c.name and c.quick >= quick]
    if not chosen:
        raise InputError(f"--case {pattern}: no case has this in its name; leave it out")
    cases = [
        harness.Case(
            c.name, partial(attempt_named, c.name), c.limit_s, partial(CaseResult, c.name, "failed")
        )
        for c in chosen
    ]
    return Study("stability", CaseResult, cases, report_of)


def report_of(results: Sequence[CaseResult]) -> Report:
    """Counts and every case."""
    verdicts = [result.verdict for result in results]
    names: tuple[Verdict, ...] = ("passed", "refused", "failed")
    counts: dict[str, int] = {
        "cases": len(results),
        **{name: verdicts.count(name) for name in names},
    }
    text = f"{len(results)} cases: " + ", ".join(f"{counts[name]} {name}" for name in names)
    lines = [f"{r.verdict:8} {r.name:44} {r.ms:8.0f} ms  {r.detail}" for r in results]
    return Report(numbers=counts, text="\n".join([*lines, text]), rows_name="results")
