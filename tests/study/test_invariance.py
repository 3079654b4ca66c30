"""Neither mesh, nor rim, nor the frames before change what is found in a frame."""

import numpy as np
import pytest

from bubbleviz.frames.recording import Recording
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.study.accuracy import invariance

PATCH = frozenset({"patch"})


def test_on_simulated_rubber():
    found = invariance.run_invariance(
        load_sensor("pico_flexx_75mm"), invariance.quick_invariance_grid()
    )
    assert {each.changed for each in found} == {invariance.MESH, invariance.RIM}
    assert all(0.0 < abs(each.change_relative) < invariance.LARGEST_CHANGE for each in found)
    assert all(target.met for target in invariance.targets(found))
    assert "What should not matter" in invariance.to_text(found)


@pytest.mark.long  # in short: on simulated rubber, above
def test_on_the_real_press(punyo_press):
    sensor = load_sensor("punyo_oval_d405")
    with Recording(punyo_press) as recording:
        frames = [recording[k] for k in range(62, 90, 4)]
    model = SensorModel.of(sensor, frames[0].intrinsics)
    forces = {
        name: np.median([force_of(each.process(frame, PATCH)) for frame in frames][3:])
        for name, each in invariance.variants(model).items()
    }
    usual = forces.pop("")
    assert usual > 2.0
    assert set(forces) == {invariance.MESH, invariance.RIM}
    for force in forces.values():
        assert abs(force / usual - 1.0) < invariance.LARGEST_CHANGE


@pytest.mark.long  # in short: in tests/inverse/test_rubber_estimator.py
def test_how_frames_of_the_real_press_are_reached(punyo_press):
    """Alone, played, and after jumps from before, within and after the hold: the same patch."""
    hold = range(72, 90, 2)
    with Recording(punyo_press) as recording:
        frames = {k: recording[k] for k in (62, 68, *range(72, 90))}
    pipeline = Pipeline.of(load_sensor("punyo_oval_d405"), frames[72].intrinsics)

    def found(*way):
        pipeline.restart()
        return [pipeline.process(frames[k], PATCH) for k in way][-1]

    played = [pipeline.process(frames[k], PATCH) for k in range(72, 90)][::2]
    ways = [played, *([found(j, k) for k in hold] for j in (62, 68, 77, 89))]
    alone = [found(k) for k in hold]
    area = np.array([[r.patch.area_m2 for r in way] for way in (alone, *ways)])
    force = np.array([[force_of(r) for r in way] for way in (alone, *ways)])
    change = np.abs(area[1:] / area[0] - 1.0)
    assert np.median(change) < 0.003
    assert np.quantile(change, 0.9) < 0.05
    assert np.abs(force[1:] / force[0] - 1.0).max() < 0.015


def test_frames_of_the_onset_are_solved_as_far_when_played(punyo_press):
    """Contacts of two to nine nodes, whose images fit no shape to the noise."""
    with Recording(punyo_press) as recording:
        frames = [recording[k] for k in range(60, 71)]
    pipeline = Pipeline.of(load_sensor("punyo_oval_d405"), frames[0].intrinsics)
    played = [pipeline.process(frame, PATCH) for frame in frames][3:]
    alone = []
    for frame in frames[3:]:
        pipeline.restart()
        alone.append(pipeline.process(frame, PATCH))
    assert [r.estimate.status for r in played] == [r.estimate.status for r in alone]
    for value, median, most in ((force_of, 0.005, 0.05), (area_of, 0.05, 0.4)):
        change = [abs(value(a) / value(b) - 1.0) for a, b in zip(played, alone, strict=True)]
        assert np.median(change) < median
        assert max(change) < most


def area_of(result):
    return result.patch.area_m2


def force_of(result):
    return np.linalg.norm(result.patch.force_n)
