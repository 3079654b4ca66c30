"""The study of random errors: which frames count as reported, within the interval or wrong."""

import pytest

from benchmarks.faults import FaultRow, faults_study, report_of


def row(kind, reported, covered, worst_n=0.0):
    return FaultRow("flat pico", kind, 0.1, "m", 10, reported, covered, worst_n)


def test_unflagged_frames_outside_their_interval_are_wrong():
    report = report_of([row("offset", 10, 0), row("offset", 0, 9, 0.7), row("hole", 2, 8)])
    (faults,) = report.tables
    wrong = {record["kind"]: record["wrong"] for record in faults.records}
    assert wrong == pytest.approx({"offset": 0.05, "hole": 0.0, "all": 1 / 30})
    assert faults.records[-1]["worst_n"] == 0.7
    assert report.targets[0].met is False


def test_a_shift_of_the_gas_pressure_of_a_linear_sensor_is_judged_frame_by_frame():
    study = faults_study(3, seed=0)
    flat = next(case for case in study.cases if "flat pico" in case.name)
    (found,) = flat.run()
    assert (found.kind, found.unit) == ("gas pressure", "Pa")
    assert 0 < found.reported + found.covered <= found.frames == 10


@pytest.mark.long  # in short: tests/live/test_assembler.py
def test_frozen_camera_is_reported():
    study = faults_study(30, seed=0)
    frozen = next(case for case in study.cases if case.name.endswith("flat pico: frozen"))
    (found,) = frozen.run()
    assert found.reported == found.frames == 40
