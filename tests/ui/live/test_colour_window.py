"""Colour images of a live source: subscription while shown, and messages while waiting."""

from dataclasses import replace

import pytest
from fakes import SpeckledSource, record, small_sensor

from bubbleviz.recordings import LAG, NO_COLOUR, Message
from bubbleviz.sensor import sensor_to_toml
from bubbleviz.shear import COLLECTED
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.model.scene_presets import load_scene

COLOUR = "/bubble/color/image_raw"
RUBBER = small_sensor("rubber dome", nodes=80, prestretch=1.2)


def connected(live, frames, options, name="played"):
    """Replay frames as a live source; returns the messages received."""
    path, file = record(live.folder / f"{name}.mcap", frames), live.folder / "dome.toml"
    file.write_text(sensor_to_toml(RUBBER), encoding="utf-8")
    live.connect(single(f"replay:{path}?{options}", str(file)))
    heard: list[Message] = []
    live.run.session.sensors[0].stream.listen(heard.append)
    return heard


def colours(heard):
    return sum(message.topic == COLOUR for message in heard)


def show_images(live, *names):
    live.state.change(images=frozenset(names))
    live.show("images")
    live.wait(lambda: live.window.images.cells.keys() >= set(names))


def words(live, name):
    """Heading of an image without line breaks and spaces."""
    return str(live.window.images.cells[name].text).replace("<br>", "").replace(" ", "")


def test_colour_is_subscribed_only_while_shown_and_awaited(open_bench):
    """First the image, then the scene Shear, then neither."""
    pytest.importorskip("cv2")
    live = open_bench()
    heard = connected(live, SpeckledSource(RUBBER), "loop=1")
    live.wait_for_messages(20)
    assert colours(heard) == 0
    show_images(live, "colour")
    image = lambda: live.inspection.colour  # noqa: E731
    live.wait(lambda: image() is not None and image().rgb is not None)
    assert image().rgb.shape == (60, 80, 3) and colours(heard) > 0
    live.window.panels["images"].hide()
    live.wait(lambda: "images" not in live.state.settings.panels)
    live.wait_for_frames()
    heard.clear()
    live.wait_for_messages(20)
    assert colours(heard) == 0
    live.window.use_scene(load_scene("shear"))
    reference = live.window.shear.reference
    live.wait(lambda: f"{COLLECTED - LAG} images without contact" in reference.text())
    live.wait(lambda: live.result.texture.colour.rgb is not None)
    live.wait(lambda: live.result.flow is not None)
    # the first colour image of another one is a quarter of an hour away
    source, late_s = SpeckledSource(RUBBER), 900.0
    first = replace(source[0], find_colour=None)
    colour = replace(source[1].colour, time_s=late_s)
    frames = [replace(first, index=k, time_s=k / 30.0) for k in range(300)]
    late = replace(first, time_s=late_s, find_colour=lambda _: colour)
    connected(live, [*frames, late], "speed=0.2", "late")
    show_images(live, "colour", "flow")
    live.show("shear")
    said = f"waiting for colour images on {COLOUR}"
    for name in ("colour", "flow"):
        live.wait(lambda name=name: said.replace(" ", "") in words(live, name))
    live.wait(lambda: live.window.shear.reference.text() == f"Depth alone: {said}")
    # no waiting for a source without colour
    none = (replace(frame, find_colour=None) for frame in source)
    connected(live, none, "loop=1", "grey")
    live.wait(lambda: words(live, "colour") == "Colour" + NO_COLOUR.replace(" ", ""))
