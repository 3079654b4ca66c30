"""The zero of the gas pressure of a live sensor: learned, kept, moved and doubted."""

from pathlib import Path

from live_bench import connected, sensor_file
from PySide6.QtCore import Qt
from window_driver import CTRL, SHIFT


def counts(live):
    live.window.live.update_status()
    return str(live.window.live.counts.toolTip())


def with_gauge(live, gauge_pa):
    """Open a sensor file of another gauge pressure, and go on with it."""
    live.window.open_file(Path(sensor_file(live.folder, "other", gauge_pressure_pa=gauge_pa)))
    live.wait(lambda: live.pipeline.model.sensor.pneumatics.gauge_pressure_pa == gauge_pa)
    live.follow(5)


def test_the_zero_is_learned_again_on_request_and_moved_by_another_sensor_file(open_bench):
    live = connected(open_bench)
    zero = live.learn_zero(shift_pa=250.0)
    assert "gas zero +250 Pa" in counts(live)
    live.key(Qt.Key.Key_Z)  # no key of anything: it is beside Ctrl+Z
    assert not zero.waiting
    live.key(Qt.Key.Key_G, CTRL | SHIFT)
    assert zero.waiting and "waiting for contact-free frames" in counts(live)
    live.learn_zero(shift_pa=400.0)
    live.undo()
    assert "gas zero +250 Pa" in counts(live) and not zero.waiting
    live.redo()
    assert zero.waiting
    live.undo()
    # else its own gauge pressure is read as contact, or hides it, until somebody zeroes it
    with_gauge(live, 3585.5)
    assert "gas zero -750 Pa, waiting for contact-free frames" in counts(live)


def test_a_sensor_file_that_the_gas_pressure_at_rest_contradicts_is_warned_of(open_bench):
    live = connected(open_bench)
    for gauge_pa, warned in ((5585.5, False), (10585.5, True)):
        live.learn_zero(103_910.0)
        with_gauge(live, gauge_pa)
        with live.bot.waitSignal(live.live_controller.looked):
            pass
        assert live.window.message.isVisible() == warned
        assert ("of 103.9 kPa without contact, 111.9 kPa (atmospheric" in live.said) == warned
