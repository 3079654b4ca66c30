"""The table of stages."""

import numpy as np
import pytest

from benchmarks.stages import Machine, StageSizes, stage_text, stage_times
from bubbleviz.sensor import load_sensor


@pytest.fixture(scope="module")
def sensor():
    return load_sensor("pico_flexx_75mm")


def test_stages_take_longer_than_their_floor(sensor):
    """On a very slow machine all are at their floor; on this one none is below."""
    sizes = StageSizes((9_600, 4_800), (200, 300), 1, source_nodes=500)
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


def test_floor_is_the_slower_of_memory_and_arithmetic():
    machine = Machine(bytes_per_s=1e9, flops_per_s=1e9)
    assert machine.floor_ms(2e6, 1e6) == pytest.approx(2.0)
    assert machine.floor_ms(1e6, 3e6) == pytest.approx(3.0)
