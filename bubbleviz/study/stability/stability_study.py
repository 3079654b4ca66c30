"""The stability study: every case in a process of its own, within its limit of time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from bubbleviz.processes.worker_process import MEMORY_LIMIT_BYTES, Outcome, WorkerProcess
from bubbleviz.study.stability.case import Case, Verdict, attempt
from bubbleviz.study.stability.stability_cases import all_cases


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


def attempt_named(name: str) -> tuple[Verdict, str]:
    """Run the shipped case of that name (in a worker process)."""
    return attempt(next(case for case in all_cases() if case.name == name))


def run_stability(
    cases: Sequence[Case], tick: Callable[[CaseResult], None] = lambda _: None
) -> list[CaseResult]:
    """Run shipped cases in a process of their own, each within its limit of time."""
    results = []
    with WorkerProcess(MEMORY_LIMIT_BYTES) as worker:
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
