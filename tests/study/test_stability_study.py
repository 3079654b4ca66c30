"""The stability study: cases, verdicts, and detection of a broken estimator."""

import json
import os
import time
from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.errors import InputError, SolveError
from bubbleviz.pipeline import Pipeline
from bubbleviz.processes import WorkerProcess
from bubbleviz.study.stability import Case, FailedError, Trial, all_cases, attempt, stability_study
from tests.program import facts_of, refusal


def test_there_are_enough_cases_of_every_kind():
    names = [case.name for case in all_cases()]
    assert len(names) == len(set(names)) >= 80
    for word in (
        "tension 1e-3", "tension 1e6", "gauge 0.001", "gauge 10 psi", "dome 2 %", "dome 150 %",
        "chamber 1e-7", "chamber 1e1", "30 nodes", "50000 nodes", "slivers of 0.5", "needle",
        "plate over everything", "wholly inside", "grazing", "90 % of the height", "two far",
        "gas pressure measured, nan", "noise 0 mm", "noise 10 mm", "0 valid", "1 valid", "2 valid",
        "30 % outliers", "saturated", "constant", "millimetres for metres", "frozen", "float32",
        "big-endian", "NaN in the sensor pose", "rubber, λ 1.0001", "rubber, dome 2 %",
        "over-inflated", "rubber, 30 nodes", "rubber, 5000 nodes", "rubber, press of 45 mm",
        "rubber, half of the membrane hidden",
    ):  # fmt: skip
        assert any(word in name for name in names), word
    assert 10 <= sum(case.quick for case in all_cases()) < len(names) / 2


def test_quick_cases_all_pass_or_are_refused():
    every = 4 if "TEST_ALL" in os.environ else 24
    study = stability_study(quick=True)  # all of them: bubbleviz study stability --quick
    found = replace(study, cases=study.cases[::every]).run().to_dict()
    wrong = [f"{r['name']}: {r['detail']}" for r in found["results"] if r["verdict"] == "failed"]
    assert wrong == []
    assert found["cases"] == found["passed"] + found["refused"] == len(study.cases[::every])


SMALL = Trial({"membrane.nodes": 300}, truth_nodes=800, repeats=1)


class Broken(Pipeline):
    """A pipeline whose estimates are spoilt on the way out."""

    def process(self, frame, products):
        result = super().process(frame, products)
        estimate = replace(result.estimate, **self.spoil(result.estimate))
        return replace(result, estimate=estimate, patch=self.patch(estimate))


def nothing_there(estimate):
    zero = np.zeros_like(estimate.displacement_m)
    return {
        "status": "no_contact", "displacement_m": zero, "contact_pressure_pa": zero,
        "gas_pressure_change_pa": 0.0, "residual_rms_m": 1e-3, "force_n": np.zeros(3),
        "nodal_force_n": np.zeros_like(estimate.nodal_force_n),
    }  # fmt: skip


def times(factor, *names):
    return lambda estimate: {name: factor * getattr(estimate, name) for name in names}


def other_gas(estimate):
    return {"gas_pressure_change_pa": estimate.gas_pressure_change_pa + 50.0}


TWICE = times(2.0, "contact_pressure_pa")
ALL_TWICE = times(2.0, "contact_pressure_pa", "displacement_m", "gas_pressure_change_pa")
MUTANTS = {
    "twice the pressure": (TWICE, "balance"),
    "twice of everything": (ALL_TWICE, "instead of"),
    "nothing there": (nothing_there, "no_contact with 0 N"),
    "not a number": (
        lambda e: {"displacement_m": np.where(e.displacement_m < 0.0, np.nan, e.displacement_m)},
        "not finite",
    ),
    "not optimal": (lambda e: {"kkt_residual": 0.2}, "KKT"),
    "unlike the image": (lambda e: {"residual_rms_m": 0.05}, "misfit"),
    "other gas": (other_gas, "gas law|balance"),
}
RUBBER_MUTANTS = {
    "twice the pressure": (TWICE, "balance"),
    "half the way": (times(0.5, "displacement_3d_m"), "balance"),
    "other gas": (other_gas, "balance|gas law"),
    "another force": (times(1.1, "force_n"), "differs from the integral of pressure and friction"),
    "weak": (lambda e: {"status": "no_contact"}, "but the estimate has contact pressure"),
}
SMALL_RUBBER = replace(
    SMALL, sensor={"membrane.nodes": 300, "membrane.prestretch": 1.2}, object_name="sphere"
)


@pytest.mark.parametrize(
    ("trial", "spoil", "words"),
    [
        *(pytest.param(SMALL, *mutant, id=name) for name, mutant in MUTANTS.items()),
        *(
            pytest.param(SMALL_RUBBER, *mutant, id=f"rubber, {name}")
            for name, mutant in RUBBER_MUTANTS.items()
        ),
    ],
)
def test_a_broken_estimator_fails(trial, spoil, words):
    with pytest.raises(FailedError, match=words):
        replace(trial, make=type("Spoilt", (Broken,), {"spoil": staticmethod(spoil)}))()


@pytest.mark.parametrize("trial", [SMALL, SMALL_RUBBER])
def test_the_same_trial_passes_unbroken(trial):
    verdict, detail = attempt(Case("whole", trial, "solve"))
    assert verdict == "passed", detail


def test_a_pipeline_that_remembers_too_much_fails():
    class Stuck(Broken):
        first = None

        def spoil(self, estimate):
            self.first = self.first or vars(estimate)
            return self.first

    streak = Trial(depths_m=(0.012, -0.01), make=Stuck)
    assert attempt(Case("stuck", streak))[0] == "failed"


def refuse():
    raise SolveError("status no_data")


def bad_input():
    raise InputError("x.toml: no")


@pytest.mark.parametrize(
    ("run", "must", "verdict"),
    [
        (lambda: "fine", "either", "passed"),
        (lambda: "fine", "solve", "passed"),
        (lambda: "fine", "refuse", "failed"),
        (refuse, "either", "refused"),
        (refuse, "solve", "failed"),
        (bad_input, "refuse", "refused"),
    ],
)
def test_verdicts(run, must, verdict):
    assert attempt(Case("a", run, must))[0] == verdict


def divide():
    return 1 // 0


@pytest.mark.long  # in short: tests/processes
def test_a_worker_survives_what_it_calls():
    with WorkerProcess() as worker:
        assert worker.call(abs, -2, limit_s=60.0).value == 2
        raised = worker.call(divide, limit_s=60.0)
        assert raised.kind == "raised"
        assert "ZeroDivisionError" in raised.detail
        assert worker.call(time.sleep, 30, limit_s=0.2).kind == "hung"
        died = worker.call(os._exit, 3, limit_s=60.0)
        assert (died.kind, died.detail) == ("died", "the process ended with code 3")
        assert worker.call(abs, -3, limit_s=60.0).value == 3


def test_errors_outside_the_contract_are_not_caught():
    with pytest.raises(ZeroDivisionError):
        attempt(Case("a", divide))


def test_command(tmp_path):
    words = ("study", "stability", "--case", "sensor pose in mm", "--out", tmp_path / "new")
    found = facts_of(*words)
    assert {k: found[k] for k in ("cases", "passed", "refused", "failed")} == {
        "cases": 1, "passed": 0, "refused": 1, "failed": 0,
    }  # fmt: skip
    assert set(found["results"][0]) == {"name", "verdict", "detail", "ms"}
    assert json.loads((tmp_path / "new" / "stability.json").read_text()) == found
    assert "exists" in refusal(*words)
    assert "no such case" in refusal("study", "stability", "--case", "no such case")
