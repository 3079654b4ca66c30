"""The speed study: what it measures adds up; growth and targets on known numbers."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.sensor import load_sensor
from bubbleviz.study.accuracy.accuracy_study import Setup, with_nodes
from bubbleviz.study.speed import speed_report
from bubbleviz.study.speed.speed_study import (
    Run,
    SpeedRow,
    contact_runs,
    measure,
    read_ms,
    run_speed,
    scaled_camera,
)
from bubbleviz.study.speed.stage_table import Machine, StageSizes, stage_text, stage_times
from bubbleviz.study.speed.stopwatch import Stopwatch


@pytest.fixture(scope="module")
def sensor():
    return load_sensor("pico_flexx_75mm")


@pytest.fixture(scope="module")
def measured(sensor):
    return measure(sensor, Run("stream", Setup(nodes=300), frames=3))


def test_stages_add_up_to_the_total(measured):
    stages = [getattr(measured, f"{name}_ms") for name in speed_report.STAGES]
    assert all(np.isfinite(stages))
    by_name = dict(zip(speed_report.STAGES, stages, strict=True))
    assert by_name.pop("linearise") >= 0.0  # rays are not cast again where little moved
    assert min(list(by_name.values())[:3]) > 0.0
    assert measured.solver == "linear"
    assert measured.frames == 3
    assert measured.memory_peak_bytes >= 0  # here it may all fit into memory freed before
    assert 0.0 < measured.iou_mean <= 1.0


@pytest.mark.long
def test_both_membranes_are_measured_in_contact(sensor):
    """On the exact membrane: the linear one is off by more than noise."""
    small = with_nodes(sensor, 300)
    exact, linear = (measure(small, run) for run in contact_runs(None, frames=2))
    assert (exact.solver, linear.solver) == ("rubber", "linear")
    assert exact.total_ms > exact.solve_ms > 0.0
    assert exact.force_error_relative_median < 0.03 < linear.force_error_relative_median
    text = speed_report.to_text(speed_report.Speed([exact, linear], 0.1))
    assert "contact, exact membrane" in text


def test_the_real_press_is_measured_where_it_is(sensor, punyo_press):
    run = contact_runs(punyo_press, frames=2)[-1]
    row = measure(sensor, run)
    assert row.sweep == "recording" and row.pixels == 640 * 480
    assert 5 < row.frames < 40


def test_a_run_that_breaks_says_why(sensor):
    (row,) = run_speed(sensor, [Run("stream", Setup("magic"), frames=1)])
    assert "magic" in row.error
    text = speed_report.to_text(speed_report.Speed([row], 0.1))
    assert "magic" in text


def test_scaled_camera_sees_the_same(sensor):
    for pixels in (5_000, 1_000_000):
        camera = scaled_camera(sensor, pixels).camera
        assert camera.width * camera.height == pytest.approx(pixels, rel=0.01)
        for name, length, focal in (("cx", "width", "fx"), ("cy", "height", "fy")):
            left = [(-0.5 - getattr(c, name)) / getattr(c, focal) for c in (camera, sensor.camera)]
            assert left[0] == pytest.approx(left[1])
            right = [
                (getattr(c, length) - 0.5 - getattr(c, name)) / getattr(c, focal)
                for c in (camera, sensor.camera)
            ]
            assert right[0] == pytest.approx(right[1])


def test_reading_is_measured(sensor):
    assert read_ms(sensor, frames=3) > 0.0


def test_stages_take_longer_than_their_floor(sensor):
    """On a machine that can do nothing fast all are at their floor; on this one none is below."""
    sizes = StageSizes((9_600, 4_800), (200, 300), 1)
    machine = Machine.measured()
    assert 1e8 < machine.bytes_per_s < 1e13 and 1e8 < machine.flops_per_s < 1e14
    times = stage_times(sensor, sizes, machine)
    assert [t.stage for t in times][:3] == ["decode", "straighten", "observe"]
    assert {"estimate, linear", "estimate, exact", "patch", "pose", "export"} < {
        t.stage for t in times
    }
    assert all(t.ms > t.floor_ms > 0.0 for t in times)
    assert all(np.isfinite([t.by_pixels, t.by_nodes]).all() for t in times)
    lines = stage_text(times, sizes, machine).splitlines()
    assert len(lines) == 4 + len(times) and lines[0].startswith("9600 pixels, 200 nodes")


def test_the_floor_is_the_slower_of_moving_and_multiplying():
    machine = Machine(bytes_per_s=1e9, flops_per_s=1e9)
    assert machine.floor_ms(2e6, 1e6) == pytest.approx(2.0)
    assert machine.floor_ms(1e6, 3e6) == pytest.approx(3.0)


class Part:
    def solve(self, x):
        return 2 * x


class Whole:
    def __init__(self):
        self.part, self.other = Part(), Part()


def test_stopwatch_measures_this_instance_alone():
    whole, untouched = Whole(), Part()
    watch = Stopwatch(whole)
    assert whole.part.solve(3) == 6
    assert set(watch.lap()) == {"solve"}
    assert watch.lap() == {}
    untouched.solve(1)
    assert watch.lap() == {}


def test_peak_memory_sees_what_was_freed_again():
    """In a small process: of a large one the system may take cold memory away meanwhile."""
    code = (
        "import numpy as np\n"
        "from bubbleviz.study.speed.stopwatch import PeakMemory\n"
        "with PeakMemory() as memory:\n"
        "    block = np.ones(60_000_000)\n"
        "    del block\n"
        "print(memory.increase_bytes)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 300_000_000


def rows_of(sweep, sizes, exponent, solver="osqp"):
    return [
        SpeedRow(sweep, f"{solver}_{n}", solver, *((n, 38_304) if sweep == "nodes" else (800, n)),
                 5, total_ms=1e-3 * n**exponent, memory_peak_bytes=n**2)
        for n in sizes
    ]  # fmt: skip


def test_growth_of_known_rows():
    rows = rows_of("nodes", (200, 1_000, 5_000, 20_000), 1.4)
    (growth,) = speed_report.growths(rows)
    assert (growth.sweep, growth.setup, growth.sizes) == ("nodes", "osqp", 3)
    assert growth.exponent == pytest.approx(1.4)
    assert growth.memory_exponent == pytest.approx(2.0)


def test_targets_of_known_rows(measured, tmp_path):
    fast = replace(measured, setup="default", total_ms=6.0, total_p95_ms=12.0)
    base = replace(fast, sweep="baseline", iou_mean=0.8)
    loose = replace(base, setup="osqp-cold_eps1e-03", total_ms=30.0, iou_mean=0.7)
    same = replace(base, setup="osqp-cold_eps1e-05", total_ms=90.0, iou_mean=0.795)
    rows = [
        *(fast, base, loose, same),
        *rows_of("nodes", (1_000, 20_000), 1.5),
        *rows_of("pixels", (38_304, 10**6), 0.5),
    ]
    found = speed_report.Speed(rows, 0.3)
    aims = speed_report.targets(found)
    assert len(aims) == 5
    assert all(aim.met for aim in aims)
    assert "eps1e-05" in aims[2].name and aims[2].value == pytest.approx(15.0)
    slower = replace(fast, total_ms=9.5, total_p95_ms=17.0)
    rows = [
        *(slower, replace(base, total_ms=9.5), loose, same),
        *rows_of("nodes", (1_000, 20_000), 1.7),
        *rows_of("pixels", (38_304, 10**6), 0.9),
    ]
    assert not any(aim.met for aim in speed_report.targets(speed_report.Speed(rows, 0.3)))
    speed_report.write(found, tmp_path)
    data = json.loads((tmp_path / "speed.json").read_text())
    assert {"read_ms", "targets", "growth", "rows"} == set(data)
    assert (tmp_path / "speed.png").stat().st_size > 10_000
