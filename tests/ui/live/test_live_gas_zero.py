"""The zero of the gas pressure of a live sensor: learned, kept, moved and doubted."""

from __future__ import annotations

import pytest
from live_bench import Open, connected, robot_sensor
from PySide6.QtCore import Qt

from bubbleviz.calibration.pressure_zero import ENOUGH
from bubbleviz.sensor import sensor_to_toml

CTRL, SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier


def test_the_zero_of_the_gas_pressure_is_learned_again_on_request(open_bench: Open) -> None:
    live = connected(open_bench)
    zero = live.run.session.sensors[0].zero
    zero.zero_now()
    for _ in range(ENOUGH):
        zero.learn(zero.reference_pa + 250.0, contact_free=True)
    live.window.live.show_now()
    assert "gas zero +250 Pa" in live.window.live.counts.toolTip()
    live.key(Qt.Key.Key_Z)  # no key of anything: it is beside Ctrl+Z
    assert not zero.waiting
    live.key(Qt.Key.Key_G, CTRL, SHIFT)
    assert zero.waiting
    live.window.live.show_now()
    assert "waiting for a rest" in live.window.live.counts.toolTip()
    for _ in range(ENOUGH):
        zero.learn(zero.reference_pa + 400.0, contact_free=True)
    live.key(Qt.Key.Key_Z, CTRL)
    live.window.live.show_now()
    assert "gas zero +250 Pa" in live.window.live.counts.toolTip() and not zero.waiting
    live.key(Qt.Key.Key_Z, CTRL, SHIFT)
    assert zero.waiting


def test_another_sensor_file_moves_the_zero_of_the_gas_pressure(open_bench: Open) -> None:
    """Else its own gauge pressure is read as contact, or hides it, until somebody zeroes it."""
    live = connected(open_bench)
    zero = live.run.session.sensors[0].zero
    zero.zero_now()
    for _ in range(ENOUGH):
        zero.learn(zero.reference_pa + 250.0, contact_free=True)
    sensor = robot_sensor()
    gas = sensor.pneumatics.model_copy(update={"gauge_pressure_pa": 3585.5})
    stiffer = live.folder / "stiffer.toml"
    stiffer.write_text(sensor_to_toml(sensor.model_copy(update={"pneumatics": gas})))
    live.window.open_file(stiffer)
    live.wait(lambda: live.pipeline.model.sensor.pneumatics == gas)
    live.follow()
    live.window.live.show_now()
    assert "gas zero -750 Pa, waiting for a rest" in live.window.live.counts.toolTip()


@pytest.mark.parametrize(("gauge_pa", "warned"), [(5585.5, False), (10585.5, True)])
def test_a_sensor_file_that_the_gas_pressure_at_rest_contradicts_is_warned_of(
    open_bench: Open, gauge_pa: float, warned: bool
) -> None:
    live = connected(open_bench)
    zero = live.run.session.sensors[0].zero
    zero.zero_now()
    for _ in range(ENOUGH):
        zero.learn(103_910.0, contact_free=True)
    sensor = robot_sensor()
    gas = sensor.pneumatics.model_copy(update={"gauge_pressure_pa": gauge_pa})
    other = live.folder / "other.toml"
    other.write_text(sensor_to_toml(sensor.model_copy(update={"pneumatics": gas})))
    live.window.open_file(other)
    live.wait(lambda: live.pipeline.model.sensor.pneumatics == gas)
    live.follow(5)
    with live.bot.waitSignal(live.live_controller.looked):
        pass
    assert live.window.message.isVisible() == warned
    told = live.window.message.label.text()
    assert ("of 103.9 kPa without contact, 111.9 kPa (atmospheric" in told) == warned
