"""Recording, markers and publishing of live sources."""

import re
import resource
import signal
import time
from pathlib import Path

import numpy as np
from live_bench import IMAGE, STRING, connected_bench, messages_by_type
from PySide6.QtCore import QPoint, QSettings, Qt
from PySide6.QtWidgets import QFileDialog
from rosbags.highlevel import AnyReader
from window_driver import SHIFT

from benchmarks.window.live_soak import free_port
from bubbleviz.live import SessionOptions, TopicNames, ZenohSource
from bubbleviz.recordings import Recording
from tests.live.streams import listens


def test_recording_with_folder_markers_notes_and_completion_on_close(open_bench, monkeypatch):
    QSettings("bubbleviz", "folders").clear()  # as of a new user
    live = connected_bench(open_bench)
    live.window.live.record.click()
    live.wait(lambda: live.status().messages > 5)
    own = live.stop().parent
    assert own == Path.home() / "bubbleviz-recordings" and own.is_dir()
    assert not list(Path.cwd().glob("bubbleviz-2*.mcap"))
    begun = list[str]()  # initial folders of open dialogs

    def asked(parent, title, folder, kinds):
        begun.append(folder)
        return [], ""

    monkeypatch.setattr(QFileDialog, "getOpenFileNames", asked)
    live.trigger("File › Open recording")
    chosen = str(live.folder)
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_, **__: chosen)
    live.trigger("Live › Recording folder")
    assert live.state.settings.record_folder == chosen
    live.trigger("File › Open recording")
    assert begun == [str(own), chosen]
    # complete, with markers and notes
    bar = live.window.live
    live.state.change(pre_roll_s=3.0)
    live.wait_for_frames(5)
    pressed_ns = time.time_ns()
    live.record()
    assert live.is_checked("Live › Record")
    live.key(Qt.Key.Key_M)
    live.key(Qt.Key.Key_M, SHIFT)
    live.wait(bar.note.isVisible)
    live.bot.keyClicks(bar.note, "slipped here")
    live.bot.keyClick(bar.note, Qt.Key.Key_Return)
    live.wait_for_frames(5)
    live.window.live.update_status()
    assert re.match(r"\d\d:\d\d · .* MB unwritten  ·  ", bar.counts.text())
    path = live.stop()
    assert not live.is_checked("Live › Record")
    found = messages_by_type(path)
    numbers = np.array([message.sequence for message in found[IMAGE]])
    assert np.array_equal(numbers, np.arange(numbers[0], numbers[-1] + 1))
    assert found[IMAGE][0].log_time < pressed_ns  # the pre-roll
    texts = [bytes(m.data)[8:-1].decode() for m in found[STRING]]
    assert texts[0].startswith("marker at frame") and texts[1] == "slipped here"
    assert live.state.markers
    with AnyReader([path]) as reader:
        assert {c.msgtype for c in reader.connections} == set(found)
    # nothing moves when a recording begins
    bar, view, places = live.window.live, live.window.view, []

    def place():
        live.wait_until_shown()
        bar.update_status()
        return view.mapTo(live.window, QPoint()), view.size(), bar.leave.pos(), bar.size()

    widths = range(1016, 1417, 80)
    for _ in range(2):
        places.append([])
        for width in widths:
            live.resize(width, 700)
            places[-1].append(place())
        if not live.live_controller.recording.busy:
            live.record()
    assert "unwritten" in bar.counts.text() and bar.counts.isVisible()
    assert places[0] == places[1]
    live.stop()
    # closing the window completes a recording
    live.record()
    path = Path(live.status().path)
    live.window.close()
    assert len(messages_by_type(path)[IMAGE]) > 1


def test_full_disk_is_reported_and_results_are_published_on_request(open_bench):
    live = connected_bench(open_bench)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    former = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, hard))
    try:
        live.record()
        live.wait(lambda: not live.live_controller.recording.busy)
        live.wait_for_message("File too large")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, former)
    assert not live.window.live.record.isChecked()
    live.wait_for_frames(3)
    (path,) = live.folder.glob("*.mcap")
    assert 0 < path.stat().st_size <= 600_000
    with Recording(path) as recording:
        assert len(recording) > 5
    # results are published only on request
    port = free_port()

    live.live_controller.publishing.endpoint = f"tcp/127.0.0.1:{port}"
    assert not live.live_controller.publishing.on and not listens(port)
    live.state.change(layers=frozenset(), panels=frozenset())  # the patch is not visible
    results = {"/bubbleviz/contact_patch", "/bubbleviz/contact_wrench"}
    names = TopicNames(depth="/bubbleviz/contact_patch", wrench="/bubbleviz/contact_wrench")
    place, topics = SessionOptions("test", f"tcp/127.0.0.1:{port}"), set[str]()
    source = ZenohSource(place, names)
    source.start(lambda message: topics.add(message.topic))
    try:
        live.window.live.publish.click()
        live.wait(lambda: results <= topics)
    finally:
        source.stop()
    # a recording that begins later also has the frame of reference, which is sent once
    live.record()
    live.wait_for_frames(5)
    with AnyReader([live.stop()]) as bag:
        assert bag.topics["/bubbleviz/membrane"].msgcount > 0
        placed = set()
        for connection, _, raw in bag.messages(bag.topics["/tf_static"].connections):
            for each in bag.deserialize(raw, connection.msgtype).transforms:
                placed.add((each.header.frame_id, each.child_frame_id))
    assert placed == {("bubble_depth_optical_frame", "bubble")}
    live.window.live.publish.click()
    live.wait(lambda: not listens(port))
    live.wait(lambda: not live.window.controller.client.extra_products)
