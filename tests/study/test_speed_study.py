"""The speed study: parts sum to the total; growth and targets on known numbers."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.simulation import with_nodes, with_pixels
from bubbleviz.study.accuracy import Setup
from bubbleviz.study.harness import write
from bubbleviz.study.speed import (
    STAGES,
    Row,
    Run,
    contact_runs,
    growths,
    measure,
    report_of,
    speed_study,
    targets,
)
from tests.program import python


@pytest.fixture(scope="module")
def measured(sensor):
    (row,) = measure(sensor, Run("stream", Setup(nodes=300), frames=3))
    return row


def test_stages_add_up_to_the_total(measured):
    stages = [getattr(measured, f"{name}_ms") for name in STAGES]
    assert all(np.isfinite(stages)) and min(stages[:3]) > 0.0
    assert 0.3 * sum(stages) < measured.total_ms < 3.0 * sum(stages)  # each is a median
    assert measured.solver == "linear"
    assert measured.frames == 3
    assert measured.memory_peak_bytes >= 0  # here it may all fit into memory freed before
    assert 0.0 < measured.iou_mean <= 1.0


@pytest.mark.long
def test_both_membranes_are_measured_in_contact(sensor):
    """On the exact membrane: the linear one is off by more than noise."""
    small = with_nodes(sensor, 300)
    (exact,), (linear,) = (measure(small, run) for run in contact_runs(frames=2))
    assert (exact.solver, linear.solver) == ("rubber", "linear")
    assert exact.total_ms > exact.solve_ms > 0.0
    assert exact.force_error_relative_median < 0.03 < linear.force_error_relative_median
    assert "contact, exact membrane" in report_of([exact, linear]).to_text()


@pytest.mark.long  # in short: in test_accuracy_study.py
def test_a_run_that_breaks_says_why(sensor):
    found = speed_study(sensor, [Run("stream", Setup("magic"), frames=1)]).run()
    assert not found.rows
    assert "omitted: stream magic" in found.to_text() and "no such solver" in found.to_text()


def test_scaled_camera_sees_the_same(sensor):
    for pixels in (5_000, 1_000_000):
        camera = with_pixels(sensor, pixels).camera
        assert camera.width * camera.height == pytest.approx(pixels, rel=0.01)
        for name, length, focal in (("cx", "width", "fx"), ("cy", "height", "fy")):
            left = [(-0.5 - getattr(c, name)) / getattr(c, focal) for c in (camera, sensor.camera)]
            assert left[0] == pytest.approx(left[1])
            right = [
                (getattr(c, length) - 0.5 - getattr(c, name)) / getattr(c, focal)
                for c in (camera, sensor.camera)
            ]
            assert right[0] == pytest.approx(right[1])


def test_peak_memory_sees_what_was_freed_again():
    """In a small process: of a large one the system may take cold memory away meanwhile."""
    code = (
        "import numpy as np\n"
        "from bubbleviz.processes import PeakMemory\n"
        "with PeakMemory() as memory:\n"
        "    block = np.ones(20_000_000)\n"
        "    del block\n"
        "print(memory.increase_bytes)"
    )
    assert int(python(code)) > 100_000_000


def rows_of(sweep, sizes, exponent, solver="paper"):
    return [
        Row(sweep, f"{solver}_{n}", solver, *((n, 38_304) if sweep == "nodes" else (800, n)),
            5, total_ms=1e-3 * n**exponent, memory_peak_bytes=n**2)
        for n in sizes
    ]  # fmt: skip


def test_growth_of_known_rows():
    rows = rows_of("nodes", (200, 1_000, 5_000, 20_000), 1.4)
    (growth,) = growths(rows)
    assert (growth["sweep"], growth["solver"], growth["sizes"]) == ("nodes", "paper", 3)
    assert growth["time_exponent"] == pytest.approx(1.4)
    assert growth["memory_exponent"] == pytest.approx(2.0)


def test_targets_of_known_rows(measured, tmp_path):
    fast = replace(measured, setup="default", total_ms=6.0, total_p95_ms=12.0)
    rows = [fast, *rows_of("nodes", (1_000, 20_000), 1.5), *rows_of("pixels", (38_304, 10**6), 0.5)]
    assert [aim.met for aim in targets(rows)] == [True] * 4
    slower = [
        replace(fast, total_ms=9.5, total_p95_ms=17.0),
        *rows_of("nodes", (1_000, 20_000), 1.7),
        *rows_of("pixels", (38_304, 10**6), 0.9),
    ]
    assert [aim.met for aim in targets(slower)] == [False] * 4
    report = replace(report_of(rows), rows=rows)
    write(report, tmp_path, "speed")
    data = json.loads((tmp_path / "speed.json").read_text())
    assert {"targets", "growth", "rows"} < set(data)
    assert (tmp_path / "speed.png").stat().st_size > 10_000
