"""`watch --shear`: traction, torque and slip of a live source, or why only depth is used."""

from dataclasses import replace

import numpy as np
import pytest
from streams import messages_in

from bubbleviz.api.watching import Watcher
from bubbleviz.camera import ColourCamera, ColourImage, EncodedImage
from bubbleviz.diagnostics import shear_line
from bubbleviz.live import LiveSource, LiveStream, OfferedTopic
from bubbleviz.recordings import LAG, NO_COLOUR, Frame, FrameMessages
from bubbleviz.sensor_model import SensorModel
from bubbleviz.shear import COLLECTED
from tests.program import facts_of, refusal
from tests.shear.drag import Eyes, sensor as shear_sensor, stuck
from tests.shear.texture_bag import FRAMES, HELD, image, write_texture_press

NOW = 1_700_000_000_000_000_000


class HandedSource(LiveSource):
    """Delivers the frames that it is handed."""

    def __init__(self):
        super().__init__("handed")
        self.messages, self.link = FrameMessages(), "up"

    def start(self, deliver):
        self.deliver = deliver

    def hand(self, frame):
        stamp = NOW + round(1e9 * frame.time_s)
        for message in self.messages.of(frame, stamp):
            topic = OfferedTopic(message.topic, message.type)
            self.topics = tuple(dict.fromkeys((*self.topics, topic)))
            self.deliver(message._replace(arrival_ns=stamp))


def frame_of(k):
    """What both cameras see of the puck at frame k."""
    depth, grey = image(k)
    height, width = grey.shape
    encoded = EncodedImage("mono8", grey.tobytes(), width, height, width)
    lens = SensorModel.of(shear_sensor()).camera.intrinsics
    colour = ColourImage(lambda: encoded, time_s=k / 30.0, camera=ColourCamera(lens))
    return Frame(k, k / 30.0, depth, lens, find_colour=lambda _: colour)


def watched(*frames):
    """Results of frames, one after the other."""
    source = HandedSource()
    with LiveStream(source, shear_sensor()) as stream:
        stream.follow_colour()
        source.hand(frames[0])
        watcher = Watcher.on(stream, shear_sensor(), zero_gas=False, shear=True)
        for k, frame in enumerate(frames):
            if k:
                source.hand(frame)
            result = watcher.step(30.0)
            assert result is not None
            yield watcher, result


def test_images_just_before_contact_are_not_used_as_reference():
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    free = LAG + 5
    frames = [frame_of(k) for k in (*range(free), HELD, HELD + 1)]
    said = [watcher.solver.texture.words for watcher, _ in watched(*frames)]
    count = "Collecting colour images without contact: {} of {}".format
    # at the first frame the source is not known to have colour
    assert said[free - 1].endswith(count(free - 1, COLLECTED))
    assert [words.split(" and ")[-1] for words in said[free:]] == 2 * [
        count(free - 1 - LAG, COLLECTED)
    ]


def test_without_colour_depth_alone_is_reported():
    eyes, truth, statuses = Eyes(), stuck("puck", 0.004, 0.001, 8.0), []
    seen = [eyes.rest(), eyes.see(truth), eyes.see(truth, 1)]
    lens = eyes.pipeline.camera.intrinsics
    for watcher, result in watched(*(replace(frame, intrinsics=lens) for frame in seen)):
        statuses.append(result.traction.status)
        assert (
            watcher.solver.texture.words
            == "Depth alone: no colour images of this sensor in a known encoding"
        )
    assert statuses == ["no_contact", "depth_alone", "depth_alone"]
    assert shear_line(result).startswith(f"depth alone: {NO_COLOUR}")


def test_shear_without_the_exact_membrane_is_refused(sensor, press):
    words = ("watch", "--source", f"replay:{press}", "--sensor", sensor, "--shear")
    assert "prestretch): cannot estimate shear; choose solver rubber" in refusal(*words)
    told = refusal(*words, "--solver", "linear")
    assert "solver linear: cannot estimate shear; choose solver rubber" in told


@pytest.mark.long
def test_the_command_records_the_wrench_with_friction(tmp_path):
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    press, own = write_texture_press(tmp_path, {})
    for speed in (0.1, 0.02):  # on a busy machine few frames are seen
        out, source = tmp_path / f"{speed}.mcap", f"replay:{press}?speed={speed}"
        words = ("--source", source, "--sensor", own, "--shear", "--out", out)
        facts = facts_of("watch", *words)
        if facts["traction_status"].get("ok", 0) > 3:
            break
    assert 3 < facts["traction_status"]["ok"] < FRAMES
    truth = np.linalg.norm(stuck("puck", 0.004, 0.001, 8.0).force_n)
    assert facts["max_force_n"] == pytest.approx(truth, rel=0.05)
    assert "using the depth camera's" in facts["texture"]
    topics = {channel.topic for _, channel, _ in messages_in(out)}
    assert {"/bubbleviz/traction_wrench", "/bubbleviz/traction_wrench_sigma"} <= topics
    assert "/bubbleviz/slip_share" in topics
