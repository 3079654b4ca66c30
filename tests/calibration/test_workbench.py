"""Steps changed and repeated give the same numbers as one run, without needless work."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.calibration import (
    Quantity,
    SensorComparison,
    Settings,
    Step,
    Workbench,
    as_ranges,
    frame_numbers,
    write_sensor,
)
from bubbleviz.errors import InputError
from bubbleviz.progress import Cancelled
from bubbleviz.recordings import HeldFrames
from bubbleviz.sensor import load_sensor
from tests.small_press import changed

from .domes import sphere
from .identified import identify

NODES = 200
LONG = "TEST_ALL" in os.environ


class Counted(HeldFrames):
    """A source whose reads are counted."""

    reads = 0

    def __getitem__(self, index):
        self.reads += 1
        return super().__getitem__(index)


@pytest.fixture(scope="module")
def dome():
    return sphere(3, frames=20, scale=0.3)


@pytest.fixture(scope="module")
def found(dome):
    return identify(dome, dome.sensor, nodes=NODES)


@pytest.fixture
def bench(dome):
    return Workbench(Counted(list(dome)), dome.sensor)


def full(**more):
    return Settings(Step.TENSION, nodes=NODES, **more)


def test_steps_give_the_same_result_as_identify(bench, found):
    stepped = bench.work(full())
    assert stepped.tension == found.tension
    np.testing.assert_array_equal(stepped.pixels.mask, found.pixels.mask)
    assert stepped.sensor == found.sensor


@pytest.mark.parametrize(
    ("step", "known"),
    [
        (Step.START, []),
        (Step.FRAMES, ["contact_free"]),
        (Step.PIXELS, ["contact_free", "samples", "pixels"]),
        (Step.SURFACE, ["contact_free", "samples", "pixels", "surfaces"]),
    ],
)
def test_only_requested_steps_are_computed(bench, step, known):
    found = bench.work(Settings(step, nodes=NODES))
    names = ("contact_free", "samples", "pixels", "surfaces", "gauge")
    assert [name for name in names if getattr(found, name) is not None] == known
    assert not found.complete


def test_step_cancelled_anywhere_can_be_repeated(bench, dome):
    calls, shares = 0, []

    def count(step, done):
        nonlocal calls
        calls += 1
        shares.append(done)

    wanted = Workbench(dome, dome.sensor).work(full(), count).tension
    # once from nothing to all, however many steps there are
    assert shares == sorted(shares) and shares[0] < 0.1 and shares[-1] == 1.0
    for stop in (calls // 3, 2 * calls // 3) if LONG else (calls // 2,):
        left = stop

        def cancel(step, done):
            nonlocal left
            left -= 1
            if left == 0:
                raise Cancelled

        fresh = Workbench(dome, dome.sensor)
        with pytest.raises(Cancelled):
            fresh.work(full(), cancel)
        assert fresh.work(full()).tension == wanted


def test_frame_ranges():
    assert frame_numbers(((0, 2), (5, 7))) == [0, 1, 5, 6]
    assert as_ranges([0, 1, 2, 7]) == ((0, 3), (7, 8))
    assert as_ranges(range(0)) == ()


def test_a_sensor_does_not_differ_from_itself(found, tmp_path):
    write_sensor(found, tmp_path / "own.toml")
    same = SensorComparison.of(load_sensor(tmp_path / "own.toml"), found)
    assert same.largest_m < 5e-6  # the file's digits
    assert {"γ0", "height"} < {row.name for row in same.rows}
    for row in same.rows:
        assert row.name != "λ"  # the tension is constant
        assert row.old == pytest.approx(row.new, rel=2e-3, abs=2e-6), row.name


def test_comparison_has_intervals_of_both_sensors(found, tmp_path):
    stretch, gauge = Quantity(1.2, 1.15, 1.27), Quantity(2585.5, 2500.0, 2671.0)
    found = replace(found, gauge=gauge, rubber={"prestretch": stretch})
    write_sensor(found, tmp_path / "own.toml")
    comparison = SensorComparison.of(load_sensor(tmp_path / "own.toml"), found)
    rows = {row.name: row for row in comparison.rows}
    tension = found.tension.half_width
    for name, half in {"γ0": tension, "λ": 0.06, "gauge pressure": 85.5}.items():
        assert rows[name].half_width == pytest.approx(half, rel=1e-3), name
        assert rows[name].old_half_width == pytest.approx(half, rel=1e-2), name
    assert (rows["λ"].old, rows["λ"].new) == (1.2, 1.2)


def test_another_height_appears_in_table_and_image(found):
    table = SensorComparison.of(changed(found.sensor, membrane={"height_m": 0.052}), found)
    height = next(row for row in table.rows if row.name == "height")
    assert height.old - height.new == pytest.approx(2e-3, abs=2e-4)
    middle = table.difference_m[tuple(s // 2 for s in table.difference_m.shape)]
    assert middle == pytest.approx(-2e-3, abs=3e-4)  # the new membrane is nearer


def test_collected_frames_are_saved_with_a_report(dome, tmp_path):
    frames = HeldFrames(list(dome)[:12], "live")
    found = identify(frames, dome.sensor, range(12), nodes=NODES)
    write_sensor(found, tmp_path / "new.toml", tmp_path / "report", source=frames)
    origin = json.loads((tmp_path / "report" / "report.json").read_text())["origin"]
    assert origin["recording"] == "live" and origin["recording_sha256"] is None
    with pytest.raises(InputError, match="no frame"):
        HeldFrames([], "live")


def test_a_report_that_cannot_be_written_leaves_no_sensor(dome, found, tmp_path, monkeypatch):
    import bubbleviz.calibration.report as module

    def full_disk(*_):
        raise InputError("report: cannot be written (disk full)")

    monkeypatch.setattr(module, "write_report", full_disk)
    with pytest.raises(InputError, match="disk full"):
        write_sensor(found, tmp_path / "new.toml", tmp_path / "report")
    assert not list(tmp_path.iterdir())
