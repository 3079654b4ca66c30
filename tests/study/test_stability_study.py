"""The stability study: its cases, its verdicts, and that a broken estimator is found out."""

import json
import os
import time
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from bubbleviz.cli.study_commands import study
from bubbleviz.errors import InputError
from bubbleviz.pipeline import Pipeline
from bubbleviz.processes.worker_process import WorkerProcess
from bubbleviz.study.stability import attempt, stability_study
from bubbleviz.study.stability_cases import all_cases
from bubbleviz.study.stability_trial import Case, FailedError, RefusedError, Trial


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
        "rubber, half unseen",
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


SMALL = Trial({"membrane": {"nodes": 300}}, truth_nodes=1_500, repeats=1)


class Broken(Pipeline):
    """A pipeline whose estimates are spoilt on the way out."""

    spoil = staticmethod(lambda pipeline, estimate: estimate)

    def process(self, frame, products):
        result = super().process(frame, products)
        estimate = self.spoil(self, result.estimate)
        patch = self.patch(estimate)
        return replace(result, estimate=estimate, patch=patch)


def twice_the_pressure(pipeline, estimate):
    return replace(estimate, contact_pressure_pa=2.0 * estimate.contact_pressure_pa)


def twice_of_everything(pipeline, estimate):
    return replace(
        estimate,
        contact_pressure_pa=2.0 * estimate.contact_pressure_pa,
        displacement_m=2.0 * estimate.displacement_m,
        gas_pressure_change_pa=2.0 * estimate.gas_pressure_change_pa,
    )


def nothing_there(pipeline, estimate):
    zero = np.zeros_like(estimate.displacement_m)
    return replace(
        estimate, status="no_contact", displacement_m=zero, contact_pressure_pa=zero,
        gas_pressure_change_pa=0.0, residual_rms_m=1e-3,
    )  # fmt: skip


def not_a_number(pipeline, estimate):
    spoilt = estimate.displacement_m.copy()
    spoilt[7] = np.nan
    return replace(estimate, displacement_m=spoilt)


def not_optimal(pipeline, estimate):
    return replace(estimate, kkt_residual=0.2)


def unlike_the_image(pipeline, estimate):
    return replace(estimate, residual_rms_m=0.05)


def other_gas(pipeline, estimate):
    return replace(
        estimate,
        gas_pressure_change_pa=estimate.gas_pressure_change_pa + 50.0,
        contact_pressure_pa=estimate.contact_pressure_pa,
    )


MUTANTS = {
    twice_the_pressure: "balance",
    twice_of_everything: "instead of",
    nothing_there: "no_contact with 0 N",
    not_a_number: "not finite",
    not_optimal: "KKT",
    unlike_the_image: "misfit",
    other_gas: "gas law|balance",
}


SMALL_RUBBER = replace(
    SMALL, sensor={"membrane": {"nodes": 300, "prestretch": 1.2}}, object_name="sphere"
)


def another_force(pipeline, estimate):
    return replace(estimate, force_n=1.1 * estimate.force_n)


def half_the_way(pipeline, estimate):
    return replace(estimate, displacement_3d_m=0.5 * estimate.displacement_3d_m)


def weak(pipeline, estimate):
    return replace(estimate, status="no_contact")


RUBBER_MUTANTS = {
    twice_the_pressure: "balance",
    half_the_way: "balance",
    other_gas: "balance|gas law",
    another_force: "not that of pressure and friction",
    weak: "with contact pressure",
}


def spoilt(spoil):
    return type("Spoilt", (Broken,), {"spoil": staticmethod(spoil)})


@pytest.mark.parametrize("spoil", RUBBER_MUTANTS)
def test_a_broken_estimator_of_the_exact_membrane_fails(spoil):
    with pytest.raises(FailedError, match=RUBBER_MUTANTS[spoil]):
        replace(SMALL_RUBBER, make=spoilt(spoil))()


def test_the_same_rubber_passes_unbroken():
    verdict, detail = attempt(Case("whole", SMALL_RUBBER, "solve"))
    assert verdict == "passed", detail


@pytest.mark.parametrize("spoil", MUTANTS)
def test_a_broken_estimator_fails(spoil):
    with pytest.raises(FailedError, match=MUTANTS[spoil]):
        replace(SMALL, make=spoilt(spoil))()


def test_the_same_trial_passes_unbroken():
    verdict, detail = attempt(Case("whole", SMALL, "solve"))
    assert verdict == "passed", detail


def test_a_pipeline_that_remembers_too_much_fails():
    class Stuck(Broken):
        first = None

        @staticmethod
        def spoil(pipeline, estimate):
            pipeline.first = pipeline.first or estimate
            return pipeline.first

    streak = Trial(depths_m=(0.012, -0.01), make=Stuck)
    assert attempt(Case("stuck", streak))[0] == "failed"


def refuse():
    raise RefusedError("status no_data")


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


def test_a_worker_survives_what_it_calls():
    with WorkerProcess() as worker:
        assert worker.call(abs, -2, limit_s=60.0).value == 2
        raised = worker.call(divide_by, 0, limit_s=60.0)
        assert raised.kind == "raised"
        assert "ZeroDivisionError" in raised.detail
        assert worker.call(time.sleep, 30, limit_s=0.2).kind == "hung"
        died = worker.call(os._exit, 3, limit_s=60.0)
        assert (died.kind, died.detail) == ("died", "the process ended with code 3")
        assert worker.call(abs, -3, limit_s=60.0).value == 3


def divide_by(x):
    return 1 // x


def test_errors_outside_the_contract_are_not_caught():
    with pytest.raises(ZeroDivisionError):
        attempt(Case("a", divide))


def test_command(tmp_path):
    pattern = "sensor pose in mm"
    run = CliRunner().invoke(
        study, ["stability", "--case", pattern, "--json", "--out", str(tmp_path / "new")]
    )
    assert run.exit_code == 0, run.output
    found = json.loads(run.output)
    assert {k: found[k] for k in ("cases", "passed", "refused", "failed")} == {
        "cases": 1, "passed": 0, "refused": 1, "failed": 0,
    }  # fmt: skip
    assert set(found["results"][0]) == {"name", "verdict", "detail", "ms"}
    assert json.loads((tmp_path / "new" / "stability.json").read_text()) == found
    again = CliRunner().invoke(
        study, ["stability", "--case", pattern, "--out", str(tmp_path / "new")]
    )
    assert isinstance(again.exception, InputError)
    none = CliRunner().invoke(study, ["stability", "--case", "no such case"])
    assert isinstance(none.exception, InputError)
