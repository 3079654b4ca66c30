"""Live sources in the window, by clicks and keys."""

import threading
import time

import numpy as np
import pytest
from live_bench import SYNTHETIC, connected_bench, record_dents, sensor_file
from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtWidgets import QAbstractButton
from window_driver import CTRL, SHIFT, view_texts

from benchmarks.window.live_soak import free_port
from bubbleviz.live import STALE_AFTER_S
from bubbleviz_ui.engine import live_frames
from bubbleviz_ui.live.connection import single
from tests.live.streams import robot


def test_live_frames_are_shown_frozen_and_resumed(open_bench):
    live = connected_bench(open_bench)
    bar, frozen = live.window.live, "Playback › Freeze a live source"
    live.wait(lambda: bar.state.text().endswith("Hz"))
    assert "simulated" in bar.state.text() and "messages" in bar.counts.text()
    # no controls of a second sensor
    assert not bar.sensors and live.second is None
    assert not live.window.group.drawings
    assert sum(t.name.startswith("solver") for t in threading.enumerate()) == 1
    facts, history = live.state.facts, live.state.history
    assert facts.frames == len(history) == len(facts.times_s)
    assert np.all(np.diff(facts.times_s) > 0)
    assert np.isfinite(history.values["residual_m"][1 : live.shown_frame]).all()
    live.window.show_rates()
    assert live.window.status.labels["latency"].text().endswith(" ms")
    live.wait_for_frames(3)
    back = live.state.frame - 2
    live.state.seek(back)
    live.wait(lambda: live.shown_frame == back)
    assert live.state.frozen and live.is_checked(frozen)
    frames = live.state.facts.frames
    live.wait_for_messages(10)
    assert live.shown_frame == back and live.state.facts.frames <= frames + 2
    live.window.playback.buttons["Go live"].click()
    live.wait_for_frames(2)
    assert not live.state.frozen and live.shown_frame > back + 2 and not live.is_checked(frozen)
    live.show("calibration")
    box = live.window.calibration.frames.collect
    live.wait(box.button.isEnabled)
    live.key(Qt.Key.Key_L, CTRL | SHIFT)  # after disconnecting no frames can be collected
    live.wait(lambda: not box.button.isEnabled())
    assert "connect again" in box.message.text()


@pytest.mark.long  # in short: in test_live_links.py
def test_badge_of_each_kind_of_source(open_bench):
    """In the bar and the window title, for each kind of source and state."""
    bench = open_bench()
    bar, seen, opened = bench.window.live, list[str](), list[str]()
    note = lambda *_: seen.append(bar.state.text() + bench.window.windowTitle())  # noqa: E731
    told = bench.live_controller.changed, bench.live_controller.updated
    noted = [changed.connect(note) for changed in told]
    bench.window.controller.opened.connect(lambda _: opened.append("opened"))
    bench.window.view.rendering.connect(lambda: seen.append("drawn") if opened else None)
    bench.connect(single("synthetic:?frames=6", sensor_file(bench.folder)))
    bench.wait(lambda: "simulated" in bar.state.text())
    for changed, connection in zip(told, noted, strict=True):
        changed.disconnect(connection)
    before = seen[: seen.index("drawn")]
    assert any(">&nbsp;connecting&nbsp;<" in text for text in before)
    assert not any(f";{word}&" in text for text in before for word in ("live", "simulated"))
    assert " (simulated) " in bench.window.windowTitle()
    # the wait for a simulation is explained as such, also while another source stays open
    text, long = (
        bar.state.text,
        single("synthetic:?frames=600&rate=1000", sensor_file(bench.folder)),
    )
    bench.live_controller.connect_to(long)
    bench.wait(lambda: "simulating the first images, " in text() and " of 600" in text())
    assert "connecting" in text() and bar.leave.text() == "Cancel"
    bench.click(bar.leave)
    bench.wait(lambda: ">&nbsp;simulated&nbsp;<" in text() and bar.leave.text() == "Disconnect")
    bench.wait_for_frames(2)
    bench.click(bar.leave)
    bench.live_controller.connect_to(long)
    bench.wait(lambda: "simulating the first images, " in text() and " of 600" in text())
    before = text()
    bench.wait(lambda: " of 600" in text() and text() != before)
    bench.click(bar.leave)
    # a robot, which is frozen, stale, and disconnected
    word, title, changes = bar.state, bench.window.windowTitle, list[tuple[str, str]]()
    port, name = free_port(), sensor_file(bench.folder)
    with robot(port):
        bench.connect(single(f"zenoh:tcp/127.0.0.1:{port}", name))
        bench.wait(lambda: ">&nbsp;live&nbsp;<" in word.text() and " (live) " in title())
        bench.window.playback.buttons["Freeze a live source"].click()
        assert ">&nbsp;frozen&nbsp;<" in word.text() and " (frozen) " in title()
        bench.wait(lambda: word.text().endswith("Hz"))
        assert "live" not in word.text()
        bench.window.playback.buttons["Go live"].click()
        bench.wait(lambda: ">&nbsp;live&nbsp;<" in word.text())
        changed = bench.state.connection_changed
        noted = changed.connect(lambda: changes.append((title(), word.text())))
    bench.wait(lambda: " (stale) " in title() or " (reconnecting) " in title())
    changed.disconnect(noted)
    for name_in_title, name_in_bar in changes:
        badge = name_in_title.partition(" (")[2].partition(") ")[0]
        assert f">&nbsp;{badge}&nbsp;<" in name_in_bar
    bar.leave.click()
    assert ">&nbsp;disconnected&nbsp;<" in word.text() and " (disconnected) " in title()
    assert word.isVisible() and not bar.leave.isVisible() and not bar.record.isVisible()
    bench.connect(single(SYNTHETIC, name))
    bench.wait(lambda: ">&nbsp;simulated&nbsp;<" in word.text() and " (simulated) " in title())
    assert bar.leave.isVisible() and bar.record.isVisible()


def test_frame_shown_too_long_is_stale_although_images_arrive(open_bench, monkeypatch):
    """A busy computer shows a frame again and again: its age and rate, not those of the images."""
    live = connected_bench(open_bench)
    bar, solver = live.window.live, live.window.controller.client.solver
    newest, free = solver.newest, threading.Event()
    free.set()
    hindered = lambda *given, **more: (free.wait(), newest(*given, **more))[1]  # noqa: E731
    monkeypatch.setattr(solver, "newest", hindered)
    live.wait_for_frames(3)
    live.wait(lambda: "Hz, shown " in bar.state.text())
    free.clear()
    live.wait(
        lambda: ">&nbsp;stale&nbsp;<" in bar.state.text() and "shown 0.0 Hz" in bar.state.text()
    )
    shown_ns = live.result.frame.arrival_ns
    images, _, age = bar.state.text().rpartition("&nbsp; ")[2].split(", ")
    assert float(images.removesuffix(" Hz")) > 5.0
    assert age.endswith("&nbsp;s&nbsp;old")
    assert STALE_AFTER_S < float(age.partition("&")[0]) <= 0.05 + 1e-9 * (time.time_ns() - shown_ns)
    assert not live.window.status.labels["force"].isEnabled()
    free.set()
    live.wait(lambda: ">&nbsp;simulated&nbsp;<" in bar.state.text())
    assert live.window.status.labels["force"].isEnabled()


def check_buttons(window, *bars):
    """Check that all visible buttons of some bars are visible as a whole."""
    for button in (each for bar in bars for each in bar.findChildren(QAbstractButton)):
        if button.isVisible():
            at = QRect(button.mapTo(window, QPoint()), button.size())
            assert button.width() >= button.minimumSizeHint().width()
            assert window.rect().contains(at), button.text()
            assert button.visibleRegion().boundingRect().size() == button.size(), button.text()


def test_window_with_live_bar_fits_a_small_screen(open_bench):
    live = connected_bench(open_bench)
    # buttons in a narrow view, of 1024×700 pixels at 150 %
    for size in ((800, 500), (675, 427)):
        live.window.resize(*size)
        live.wait_for_frames(1)
    assert live.size == size and live.window.live.width() < 400
    check_buttons(live.window, live.window.live)
    live.trigger("View › Calibration")  # the widest panel
    live.wait_for_frames(1)
    assert live.window.width() == 675
    check_buttons(live.window, live.window.live)
    live.trigger("View › Calibration")
    # at 1024×700 minus the frame, with all panels, a note and all bars open
    window, size = live.window, (1016, 660)
    window.resize(*size)
    opened = ("Pose", "Calibration", "Compare", "Sensor", "Threshold", "3-D tools", "Images")
    for title in (*opened, "Plots"):
        window.shortcuts.actions[f"View › {title}"].trigger()
        live.wait_for_frames(1)
        assert (window.width(), window.height()) == size, title
    live.record()
    live.wait_for_frames(1)
    window.live.start_note()
    window.shortcuts.actions["Help › First steps"].trigger()
    long = "/home/robot/recordings/monday/press_of_the_ball.mcap: is no recording; "
    window.messages.add("error", long, "details")
    window.busy.wait_for(long)
    live.wait(window.busy.isVisible)
    live.wait_for_frames(1)
    assert (window.width(), window.height()) == size
    bars = (window.message, window.busy, window.hint, window.live, window.playback)
    check_buttons(window, *bars)
    assert window.status.geometry().bottom() < window.height()


def one_frame_everywhere(live):
    """Whether 3-D view, panels and status bar show the same frame."""
    status, force = live.window.status.labels, live.window.kappa.force.text()
    readout = view_texts(live)[0]
    return (
        status["frame"].text().startswith(f"frame {live.shown_frame} ")
        and status["force"].text() == f"force {force}"
        and (readout == f"contact  {force}" or (readout, force) == ("no contact", "0.00 N"))
        and live.state.frame == live.shown_frame
        and not live.window.controller.client.images_outdated
    )


def test_frozen_view_shows_one_frame_and_missed_or_dropped_frames_are_no_outage(
    open_bench, monkeypatch
):
    live = connected_bench(open_bench)
    live.window.playback.buttons["Freeze a live source"].click()
    live.wait(lambda: live.state.frozen)
    last, before_s = live.state.facts.frames - 1, live.state.facts.times_s[-1]
    live.wait_for_messages(80)  # nearly a second
    live.window.playback.buttons["Go live"].click()
    live.wait(lambda: live.state.facts.frames > last + 2)
    assert np.diff(live.state.facts.times_s)[last:].max() > STALE_AFTER_S
    assert live.state.facts.times_s[last] == before_s
    assert last not in [gap.after_frame for gap in live.state.facts.gaps]
    # a frozen view and an ended source show the same frame everywhere
    live.show("threshold")
    for _ in range(2):
        live.wait_for_frames(1)
        live.window.playback.buttons["Freeze a live source"].click()
        live.wait(lambda: live.state.frozen and one_frame_everywhere(live))
        live.window.playback.buttons["Go live"].click()
    path = record_dents(live.folder / "dents.mcap")
    live.live_controller.connect_to(single(f"replay:{path}", sensor_file(live.folder)))
    live.wait(lambda: "dents.mcap" in live.state.facts.title)
    live.wait(lambda: live.run.session.sensors[0].stream.source.link == "ended")
    live.wait(lambda: view_texts(live)[0].startswith("contact") and one_frame_everywhere(live))
    # a dropped frame gives a message, and a frozen one is kept
    live.connect(single(SYNTHETIC, sensor_file(live.folder)))
    monkeypatch.setattr(live_frames, "FRAMES_KEPT_S", 0.05)
    live.wait_for_frames(2)
    live.state.seek(0)
    live.wait_for_message("to keep all frames")
    live.state.freeze(False)
    live.wait_for_frames(2)
    live.window.message.hide()
    monkeypatch.setattr(live_frames, "FRAMES_KEPT_S", 0.0)
    for _ in range(2):
        live.wait_for_frames(2)
        live.key(Qt.Key.Key_F)
        assert live.state.frozen
        shown = live.shown_frame
        live.wait_until_shown()
        live.show("threshold")  # needs diagnostics of the frozen frame
        live.window.panels["threshold"].raise_()
        live.wait(lambda: live.window.controller.inspection.kappa_curve is not None)
        live.wait_until_shown()
        assert live.shown_frame == shown == live.state.frame and not live.window.message.isVisible()
        live.window.panels["threshold"].hide()
        live.key(Qt.Key.Key_F)
