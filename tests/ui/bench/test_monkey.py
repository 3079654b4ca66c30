"""A short run of the monkey; the long one is `python -m benchmarks.window monkey`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parents[1]
SHORT_S, FULL_S = 1.5, 6.0
PROGRAM = """
import json, sys
sys.path.insert(0, {here!r})
from fakes import small_sensor
from benchmarks.window.monkey import monkey_run
report = monkey_run(small_sensor(), None, {seconds}, seed={seed}, memory=False)
print(json.dumps([report.actions, report.problems]))
"""


def monkey(seconds: float, seed: int, before: str = "") -> tuple[int, list[str]]:
    code = before + PROGRAM.format(here=str(HERE), seconds=seconds, seed=seed)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=600,
        cwd=HERE.parents[1], env=os.environ,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    import json

    actions, problems = json.loads(done.stdout.splitlines()[-1])
    return actions, problems


def test_a_monkey_breaks_nothing() -> None:
    actions, problems = monkey(FULL_S if "TEST_ALL" in os.environ else SHORT_S, seed=7)
    assert not problems, problems[0]
    assert actions > 0


@pytest.mark.long
def test_a_monkey_finds_an_exception_in_a_slot() -> None:
    broken = (
        "from bubbleviz_ui.model.session_state import SessionState\n"
        "SessionState.choose_panel = lambda *a, **k: 1 / 0\n"
    )
    _, problems = monkey(2.0, seed=1, before=broken)
    assert any("ZeroDivisionError" in problem for problem in problems)
