"""The force does not hang on the estimator's mesh or on how firmly it holds the rim."""

import numpy as np

from bubbleviz.frames.recording import Recording
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


def force_of(result):
    return np.linalg.norm(result.patch.force_n)
