"""Gas pressure zero of a live sensor: learning, renewal, another sensor file, warnings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fakes import FRAMES, DentSource, record, small_sensor
from live_bench import connected_bench, sensor_file
from PySide6.QtCore import Qt
from window_driver import CTRL, SHIFT

from bubbleviz.sensor import sensor_to_toml
from bubbleviz.zeros import ZERO_FRAMES
from bubbleviz_ui.live.connection import single


def counts(live):
    live.window.live.update_status()
    return str(live.window.live.counts.toolTip())


def with_gauge(live, gauge_pa):
    """Open a sensor file with another gauge pressure."""
    live.window.files.open(Path(sensor_file(live.folder, "other", gauge_pressure_pa=gauge_pa)))
    live.wait(lambda: live.pipeline.model.sensor.pneumatics.gauge_pressure_pa == gauge_pa)
    live.wait_for_frames(5)


def test_gas_zero_is_renewed_on_request_and_compared_with_another_sensor_file(open_bench):
    live = connected_bench(open_bench)
    zero = live.learn_zero(shift_pa=250.0)
    assert "gas zero +250 Pa" in counts(live)
    live.key(Qt.Key.Key_Z)  # not a shortcut, but next to Ctrl+Z
    assert not zero.waiting
    live.key(Qt.Key.Key_G, CTRL | SHIFT)
    assert zero.waiting and "waiting for contact-free frames" in counts(live)
    live.learn_zero(shift_pa=400.0)
    live.undo()
    assert "gas zero +250 Pa" in counts(live) and not zero.waiting
    live.redo()
    assert zero.waiting
    live.undo()
    # else its gauge pressure would appear as contact, or hide it, until zeroed
    with_gauge(live, 3585.5)
    assert "gas zero -750 Pa, waiting for contact-free frames" in counts(live)
    # a warning if the pressure at rest contradicts the sensor file
    for gauge_pa, warned in ((5585.5, False), (10585.5, True)):
        live.learn_zero(103_910.0)
        with_gauge(live, gauge_pa)
        for _ in range(2):  # the second time, the warnings of the first were shown
            with live.bot.waitSignal(live.window.controller.client.frames_counted.timeout):
                pass
        text = "of 103.9 kPa (absolute) without contact in the source, but 111.9 kPa (atmospheric"
        assert any(text in each.text for each in live.window.messages.all) == warned


@pytest.mark.long  # in short: in test_assembler.py, test_pressure_zero.py
def test_one_warning_each_of_gas_pressure_and_images_that_never_change_and_of_drift(open_bench):
    live = open_bench()
    dent = DentSource(small_sensor())
    shown = [dent[0]] * 2 * ZERO_FRAMES + [dent[FRAMES - 1]] * 2 * ZERO_FRAMES
    frames = (
        replace(
            frame,
            index=k,
            time_s=k / 30.0,
            gas_pressure_pa=104_000.0,
            depth_m=(frame.depth_m + 1e-3).astype(np.float32),
        )
        for k, frame in enumerate(shown)
    )
    path = record(live.folder / "frozen.mcap", frames)
    file = live.folder / "small.toml"
    file.write_text(sensor_to_toml(small_sensor()), encoding="utf-8")
    live.live_controller.connect_to(single(f"replay:{path}?loop=true", str(file)))

    def warnings(words):
        return sum(words in message.text for message in live.window.messages.all)

    expected = (
        "gas pressure in the source never changes",
        "repeats one image",
        "with contact contradicts depth in the contact-free ones",
    )
    live.wait(lambda: all(map(warnings, expected)))
    live.wait_for_frames(2 * ZERO_FRAMES)  # the row of equal images grows
    assert [*map(warnings, expected)] == [1, 1, 1]
