"""Colour of a live source in the window: sent to who looks at it, and what is said meanwhile."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from fakes import SpeckledSource, small_sensor
from live_bench import Bench, Open

from bubbleviz.calibration.rest.contact_free import LAG
from bubbleviz.frames.recording_writer import RecordingWriter
from bubbleviz.live.raw_message import RawMessage
from bubbleviz.sensor import Sensor, sensor_to_toml
from bubbleviz.shear.passing_texture import COLLECTED
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.model.scene_presets import load_scene

COLOUR = "/bubble/color/image_raw"


@pytest.fixture
def rubber() -> Sensor:
    """The small dome, its membrane known exactly."""
    sensor = small_sensor("rubber dome")
    known = sensor.membrane.model_copy(update={"prestretch": 1.2})
    return sensor.model_copy(update={"membrane": known})


def connected(live: Bench, path: Path, sensor: Sensor, options: str) -> list[RawMessage]:
    """The recording played as a live source; the messages that arrive from then on."""
    name = live.folder / "dome.toml"
    name.write_text(sensor_to_toml(sensor), encoding="utf-8")
    live.connect(single(f"replay:{path}?{options}", str(name)))
    heard: list[RawMessage] = []
    live.run.session.sensors[0].stream.listen(heard.append)
    return heard


def colours(heard: list[RawMessage]) -> int:
    return sum(message.topic == COLOUR for message in heard)


def show_images(live: Bench, *names: str) -> None:
    live.state.choose(images=frozenset(names))
    live.window.panels["images"].show()
    live.wait(lambda: live.window.images.cells.keys() >= set(names))


def words(live: Bench, name: str) -> str:
    """What is written above an image, less its line breaks and spaces."""
    return str(live.window.images.cells[name].text).replace("<br>", "").replace(" ", "")


def test_colour_is_sent_while_it_is_looked_at(open_bench: Open, rubber: Sensor) -> None:
    """The image, then the scene Shear, both opened after the first frames; then neither."""
    pytest.importorskip("cv2")
    live, source = open_bench(), SpeckledSource(rubber)
    with RecordingWriter(live.folder / "speckled.mcap") as writer:
        for k in range(len(source)):
            writer.write(source[k])
    heard = connected(live, live.folder / "speckled.mcap", rubber, "loop=1")
    live.messages_come(40)
    assert colours(heard) == 0
    show_images(live, "colour")
    live.wait(lambda: live.window.controller.inspection.colour is not None)
    live.wait(lambda: live.window.controller.inspection.colour.rgb is not None)
    assert live.window.controller.inspection.colour.rgb.shape == (60, 80, 3)
    assert colours(heard) > 0
    live.window.panels["images"].hide()
    live.wait(lambda: "images" not in live.state.choices.panels)
    live.follow()
    heard.clear()
    live.messages_come(40)
    assert colours(heard) == 0
    live.window.use_scene(load_scene("shear"))
    reference = live.window.shear.reference
    live.wait(lambda: f"{COLLECTED - LAG} images without contact" in reference.text())
    live.wait(lambda: live.window.controller.result.texture.colour.rgb is not None)
    live.wait(lambda: live.window.controller.result.flow is not None)


def test_what_is_said_until_colour_comes_is_true(open_bench: Open, rubber: Sensor) -> None:
    """The first colour image of the recording is a quarter of an hour away."""
    live, source = open_bench(), SpeckledSource(rubber)
    first, late_s = replace(source[0], find_colour=None), 900.0
    colour = replace(source[1].colour, time_s=late_s)
    with RecordingWriter(live.folder / "late.mcap") as writer:
        for k in range(300):
            writer.write(replace(first, index=k, time_s=k / 30.0))
        writer.write(replace(first, time_s=late_s, find_colour=lambda _: colour))
    connected(live, live.folder / "late.mcap", rubber, "speed=0.2")
    show_images(live, "colour", "flow")
    live.window.panels["shear"].show()
    said = f"waiting for colour images on {COLOUR}"
    for name in ("colour", "flow"):
        live.wait(lambda name=name: said.replace(" ", "") in words(live, name))
    live.wait(lambda: live.window.shear.reference.text() == f"Depth alone: {said}")


def test_a_source_without_colour_is_not_waited_for(open_bench: Open, rubber: Sensor) -> None:
    live, source = open_bench(), SpeckledSource(rubber)
    with RecordingWriter(live.folder / "plain.mcap") as writer:
        for k in range(len(source)):
            writer.write(replace(source[k], find_colour=None))
    connected(live, live.folder / "plain.mcap", rubber, "loop=1")
    show_images(live, "colour")
    live.wait(lambda: words(live, "colour") == "Colournocolourimagesinthissource")
