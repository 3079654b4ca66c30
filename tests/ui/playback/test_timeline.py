"""Timeline by clicks, drags and keys, its pixels read back; playback clock."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from fakes import FIRST_CONTACT, FRAMES, DentSource, GappySource, HeldSource
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QPainter
from PySide6.QtWidgets import QInputDialog
from window_driver import CTRL, LEFT, SHIFT, painted

from bubbleviz.diagnostics import Numbers
from bubbleviz.recordings import Gap, TimeAxis
from bubbleviz_ui.engine.player import PlayClock
from bubbleviz_ui.model.frame_history import CONTACT, FREE, UNKNOWN, FrameHistory
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts
from bubbleviz_ui.playback.contacts_dialog import ContactsDialog
from bubbleviz_ui.playback.timeline import RULER, Timeline
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import rgb

BELOW, ABOVE = RULER + 8, RULER // 2


def at(timeline, frame, y=BELOW):
    return QPoint(round(timeline.x_at(frame)), y)


def drag(driver, first, last, y):
    timeline = driver.window.playback.timeline
    driver.drag(timeline, *(at(timeline, frame, y) for frame in (first, (first + last) // 2, last)))


def test_contacts_are_parted_by_frames_without_contact_alone():
    history = FrameHistory(12)
    history.contact[:] = [0, 1, 1, -1, 1, 0, 0, 2, 1, 2, 1, -1]
    history.values["force_n"][:] = [0, 1, 3, np.nan, 2, 0, 0, 9, 4, 9, 5, np.nan]
    found = [(each.first, each.last, each.largest, each.force_n) for each in history.contacts()]
    assert found == [(1, 4, 2, 3.0), (8, 10, 10, 5.0)]
    assert FrameHistory(3).contacts() == ()


def test_contacts_ranges_gaps_and_markers_by_clicks_and_drags(drive, sensor, monkeypatch):
    driver = drive(DentSource)
    assert not driver.window.playback.buttons[
        "Freeze a live source"
    ].isVisible()  # only for live sources
    driver.key(Qt.Key.Key_F)
    assert not driver.state.frozen
    # seek contacts, the largest force and a frame number by keys
    driver.key(Qt.Key.Key_PageDown, CTRL)
    assert driver.state.frame == 0 and "No further contact" in driver.window.notice.label.text()
    for frame in (FIRST_CONTACT - 1, FIRST_CONTACT, 6, 8, 7):
        driver.seek(frame)
    force = driver.state.history.values["force_n"].copy()
    driver.seek(0)
    driver.state.change(speed=0.125)
    driver.key(Qt.Key.Key_Space)
    driver.key(Qt.Key.Key_Home, CTRL)  # stays there
    assert driver.state.frame == np.nanargmax(force) and not driver.state.playing
    told = driver.window.notice.label.text()  # larger forces may be in the other frames
    assert told == f"Largest force so far; {np.isnan(force).sum()} frames left to analyse"
    driver.key(Qt.Key.Key_PageUp, CTRL)
    first = driver.state.frame
    assert driver.state.history.contact[first] == CONTACT != driver.state.history.contact[first - 1]
    driver.seek(0)
    driver.key(Qt.Key.Key_PageDown, CTRL)
    assert driver.state.frame == first
    monkeypatch.setattr(QInputDialog, "getInt", lambda *_: (7, True))
    driver.key(Qt.Key.Key_G, CTRL)
    assert driver.state.frame == 7
    timeline = driver.window.playback.timeline
    driver.seek(1)
    seen = painted(timeline)
    row = RULER + 2

    def colour(frame):
        return tuple(int(c) for c in seen[row, round(timeline.x_at(frame)) + 4])

    assert colour(1) == rgb(theme.DARK.free)
    assert colour(FIRST_CONTACT + 4) == rgb(theme.CONTACT)
    assert colour(FRAMES - 2) == rgb(theme.DARK.field)
    driver.state.change(kappa=3.0)  # another threshold drops the patches
    driver.wait(lambda: driver.state.history.contact[FIRST_CONTACT + 4] == CONTACT)
    driver.wait(lambda: driver.state.history.contact[1] == FREE)
    assert driver.state.history.contact[2] == UNKNOWN
    # click and drag seek
    driver.click(timeline, at(timeline, 7))
    assert driver.state.frame == 7
    drag(driver, 7, 2, BELOW)
    assert driver.state.frame == 2
    driver.wait_until_shown()
    assert driver.window.playback.readout.text().startswith(f"frame 2 of 0–{FRAMES - 1}")
    # a dragged range is looped
    driver.seek(0)
    drag(driver, 3, 6, ABOVE)
    assert driver.state.play_range == (3, 6) and driver.state.frame == 0
    edge = painted(timeline)[RULER + 3, round(timeline.x_at(6))]
    assert tuple(edge) == rgb(theme.DARK.accent)
    played: list[int] = []
    driver.state.frame_changed.connect(lambda index, _: played.append(index))
    driver.state.change(every_frame=True, speed=2.0)
    driver.key(Qt.Key.Key_Space)
    driver.wait(lambda: len(played) > 9)
    driver.key(Qt.Key.Key_Space)
    assert played[:9] == [3, 4, 5, 6, 3, 4, 5, 6, 3]
    drag(driver, 6, 9, ABOVE)  # drags the end of the range
    assert driver.state.play_range == (3, 9)
    driver.key(Qt.Key.Key_Backspace)
    assert driver.state.play_range is None
    # a range turns loop on, in one undo step
    driver.key(Qt.Key.Key_L)
    steps = driver.window.undo_stack.index()
    drag(driver, 3, 6, ABOVE)
    assert driver.state.play_range == (3, 6) and driver.state.settings.loop
    assert driver.window.undo_stack.index() == steps + 1
    driver.key(Qt.Key.Key_Z, CTRL)
    assert driver.state.play_range is None and not driver.state.settings.loop
    driver.key(Qt.Key.Key_Z, CTRL | SHIFT)
    assert driver.state.play_range == (3, 6) and driver.state.settings.loop
    # contacts are listed and clicked
    driver.key(Qt.Key.Key_Backspace)
    driver.choose(kappa=None)
    driver.show_source(DentSource, sensor)
    driver.trigger("Playback › Contacts")
    dialog = driver.window.findChild(ContactsDialog)
    table = dialog.table
    driver.pass_by(range(FRAMES - 2))
    driver.wait(lambda: table.rowCount() == 1 and "2 frames" in dialog.note.text())
    driver.window.controller.analysis.start()
    driver.wait(lambda: not dialog.note.isVisible())
    force = driver.state.history.values["force_n"]
    pressed, times = np.flatnonzero(force > 0.0), driver.state.facts.times_s
    first, last, largest = pressed[0], pressed[-1], int(force.argmax())
    assert [table.item(0, column).text() for column in range(table.columnCount())] == [
        f"{times[first]:.3f} s",
        f"{times[last] - times[first]:.3f} s",
        f"{first}–{last}",
        f"{force[largest]:.2f} N in frame {largest}",
    ]
    place = table.visualItemRect(table.item(0, 2)).center()
    driver.click(table.viewport(), place)
    assert driver.state.frame == largest
    dialog.close()
    # gaps and markers are drawn
    driver.show_source(GappySource, sensor)
    assert [(g.after_frame, g.missing) for g in driver.state.facts.gaps] == [(5, 3)]
    before = painted(timeline)
    red = np.flatnonzero(np.all(before == rgb(theme.GAP), axis=2).any(axis=0))
    left, right = timeline.x_at(5), timeline.x_at(6)
    assert left < red.min() < left + 0.2 * (right - left)
    assert right > red.max() > right - 0.2 * (right - left)
    assert not np.all(before == rgb(theme.DARK.marker), axis=2).any()
    driver.seek(9)
    driver.key(Qt.Key.Key_M)
    driver.seek(3)
    driver.click(driver.window.playback.buttons["Mark this frame"])
    assert driver.state.markers == (3, 9)
    marked = np.argwhere(np.all(painted(timeline) == rgb(theme.DARK.marker), axis=2))[:, 1]
    assert abs(marked.min() - timeline.x_at(3)) < 6 and abs(marked.max() - timeline.x_at(9)) < 6
    driver.key(Qt.Key.Key_PageDown)
    assert driver.state.frame == 9
    driver.key(Qt.Key.Key_M)
    assert driver.state.markers == (3,)
    assert "3 frames missing after this one" in timeline.tip(5) and "marked" in timeline.tip(3)
    # the width of an outage is its duration
    times = driver.state.facts.times_s
    places = np.array([timeline.x_at(k) for k in range(FRAMES)])
    np.testing.assert_allclose(np.diff(places) / np.diff(times), np.ptp(places) / np.ptp(times))
    for share, frame in ((0.4, 5), (0.6, 6)):
        driver.bot.mouseClick(
            timeline, LEFT, pos=QPoint(round(left + share * (right - left)), BELOW)
        )
        assert driver.state.frame == frame


def test_outage_of_a_live_source_is_drawn_when_it_ends(qtbot):
    """Frames dropped by a busy solver are no outage."""
    state, busy = SessionState(), 0.8
    times = np.arange(20) / 30.0 + busy * (np.arange(20) > 9)
    facts = SourceFacts("live", "dome", times, live=True, grows=True)
    state.open(facts, playing=True)
    timeline = Timeline(state)
    qtbot.addWidget(timeline)
    timeline.resize(900, timeline.height())
    assert not np.all(painted(timeline) == rgb(theme.GAP), axis=2).any()
    state.history.grow(21)
    outage = Gap(19, 59, 2.0)
    state.grow(replace(facts, times_s=np.append(times, times[-1] + 2.0), outages=(outage,)))
    red = np.flatnonzero(np.all(painted(timeline) == rgb(theme.GAP), axis=2).any(axis=0))
    assert timeline.x_at(19) < red.min() < red.max() < timeline.x_at(20)
    assert np.ptp(red) > 400 and "missing after this one" in timeline.tip(19)


def test_repeated_replay_is_drawn_lap_after_lap():
    axis = TimeAxis(np.tile(np.arange(5) / 10.0, 3))
    np.testing.assert_allclose(axis.places, np.linspace(0.0, 1.0, 15))
    assert list(axis.nearest(axis.places)) == list(range(15))


def test_keys_and_buttons_step_in_time_and_set_speed_mode_and_loop(drive):
    driver, plain = drive(frame=30), Qt.KeyboardModifier.NoModifier  # 30 Hz
    last = driver.state.facts.frames - 1
    for which, modifier, frame in (
        (Qt.Key.Key_End, plain, last),
        (Qt.Key.Key_Left, plain, last - 1),
        (Qt.Key.Key_Home, plain, 0),
        (Qt.Key.Key_Right, plain, 1),
        (Qt.Key.Key_Right, CTRL, 31),
        (Qt.Key.Key_Left, plain, 30),
        (Qt.Key.Key_Right, SHIFT, 33),
        (Qt.Key.Key_Right, CTRL, 63),
        (Qt.Key.Key_Left, CTRL, 33),
        (Qt.Key.Key_Left, SHIFT, 30),
    ):
        driver.key(which, modifier)
        assert driver.state.frame == frame
    driver.click(driver.window.playback.buttons["1 s back"])
    assert driver.state.frame == 0
    driver.click(driver.window.playback.buttons["0.1 s forward"])
    assert driver.state.frame == 3
    panel = driver.window.playback
    driver.key(Qt.Key.Key_Up, CTRL)
    assert driver.state.settings.speed == 2.0 and panel.speed.currentText() == "2×"
    for _ in range(8):
        driver.key(Qt.Key.Key_Down, CTRL)
    assert driver.state.settings.speed == 0.1
    driver.key(Qt.Key.Key_E)
    assert driver.state.settings.every_frame and panel.mode.currentText() == "every frame"
    driver.key(Qt.Key.Key_L)
    assert not driver.state.settings.loop and not panel.buttons["Loop"].isChecked()
    # the play button plays and pauses, and the numbers follow
    played, box = list[int](), driver.window.layers.boxes["wireframe"]
    driver.state.frame_changed.connect(lambda index, _: played.append(index))
    driver.state.change(speed=0.5, every_frame=False)
    driver.click(panel.buttons["Play / pause"])
    driver.wait(lambda: len(played) > 8)
    driver.click(panel.buttons["Play / pause"])
    assert not driver.state.playing and played == sorted(set(played))  # never backwards
    driver.wait_until_shown()
    for label in (driver.window.status.labels["frame"], panel.readout):
        assert label.text().startswith(f"frame {driver.result.frame.index} of 0–{last}")
    box.setFocus()  # as by Tab
    driver.bot.keyClick(box, Qt.Key.Key_Space)
    assert box.isChecked() and not driver.state.playing
    driver.key(Qt.Key.Key_Space)
    assert driver.state.playing
    driver.window.close()  # stops everything


def test_every_frame_mode_waits_for_the_solver_else_the_drawn_frame_is_indicated(drive, sensor):
    slow = partial(DentSource, slow_s=0.04)  # slower than the fastest speed
    driver = drive(slow)
    solved: list[int] = []
    driver.window.controller.shown.connect(lambda r: solved.append(r.frame.index))
    driver.state.change(every_frame=True, speed=8.0, loop=False)
    driver.state.set_playing(True)
    driver.wait(lambda: not driver.state.playing)
    driver.wait_until_shown()
    assert solved == [*range(1, FRAMES), FRAMES - 1]  # the last one again, as a cold solve
    assert driver.window.controller.dropped == 0
    # without it, the drawn frame is indicated and marked
    driver.state.change(every_frame=False, speed=1.0, loop=True)
    source, state, shown = HeldSource(sensor), driver.state, driver.window.controller
    source.released.set()
    driver.show_source(lambda _: source, sensor)
    state.set_playing(True)
    driver.wait(lambda: shown.result.frame.index > 0)
    source.released.clear()
    before = shown.result.frame.index
    driver.wait(lambda: state.frame not in (before, shown.result.frame.index))
    driver.key(Qt.Key.Key_M)
    assert len(state.markers) == 1 and state.markers[0] in (before, shown.result.frame.index)
    source.released.set()
    state.set_playing(False)
    driver.wait_until_shown()
    assert state.playhead == state.frame == shown.result.frame.index


def test_live_source_continues_while_the_view_is_frozen(drive):
    driver = drive(playing=True, live=True)
    panel, title = driver.window.playback, driver.window.windowTitle
    driver.wait(lambda: driver.state.frame > 2)
    assert " (simulated) " in title()
    driver.click(panel.buttons["Freeze a live source"])
    assert driver.state.frozen and " (frozen) " in title()
    frame, now = driver.state.frame, driver.state.live_frame
    driver.wait(lambda: driver.state.live_frame >= now + 5)
    assert driver.state.frame == frame and driver.state.playing
    driver.wait_until_shown()
    seen = painted(panel.timeline)
    assert np.all(seen == rgb(theme.FORCE), axis=2).any()
    driver.key(Qt.Key.Key_N)
    assert not driver.state.frozen and driver.state.frame == driver.state.live_frame
    assert " (simulated) " in title()
    driver.click(panel.timeline, at(panel.timeline, 40))
    assert driver.state.frozen and driver.state.frame == 40  # seeking freezes too
    driver.state.set_playing(False)


def test_timeline_of_36000_frames_is_fast(qtbot):
    frames = 36_000
    state = SessionState()
    state.open(SourceFacts("long", "dome", np.arange(frames) / 30.0), playing=False)
    for frame in (17_999, 18_000, 18_001):
        known = Numbers(status="ok", has_patch=True, area_m2=1e-4)
        state.history.record(frame, known, patch=True)
    assert state.history.values.nbytes < 8e6
    timeline = Timeline(state)
    timeline.resize(900, timeline.height())
    seen = np.all(painted(timeline) == rgb(theme.CONTACT), axis=2)[RULER + 3]
    assert 1 <= seen.sum() <= 2 and abs(np.flatnonzero(seen)[0] - timeline.x_at(18_000)) < 2
    assert timeline.frame_at(timeline.x_at(20_000)) == pytest.approx(20_000, abs=1)


def test_time_in_which_a_live_source_was_not_solved_is_not_painted(qtbot):
    state, times_s = SessionState(), np.arange(200) / 30.0
    times_s[100:] += 5.0  # the window was frozen, the source sent all the while
    state.open(SourceFacts("camera", "dome", times_s, live=True, grows=True), playing=False)
    for frame in range(200):
        area_m2 = 1e-4 if frame < 100 else 0.0
        known = Numbers(status="ok", has_patch=True, area_m2=area_m2)
        state.history.record(frame, known, patch=True)
    timeline = Timeline(state)
    timeline.resize(900, timeline.height())
    seen = painted(timeline)[RULER + 3]
    for time_s, colour in (
        *((1.0, theme.CONTACT), (3.2, theme.CONTACT), (3.6, theme.DARK.field)),
        *((8.0, theme.DARK.field), (8.5, theme.DARK.free), (11.0, theme.DARK.free)),
    ):
        begin, end = timeline.x_at(0), timeline.x_at(199)
        x = begin + (end - begin) * time_s / times_s[-1]
        assert tuple(seen[round(x)]) == rgb(colour)


@pytest.mark.timeout(60)
def test_absurd_duration_is_drawn_with_a_few_time_labels(qtbot, monkeypatch):
    """Of a stamp of the far future."""
    state, drawn = SessionState(), []
    state.open(SourceFacts("broken stamps", "dome", np.array([0.0, 0.1, 6e10])), playing=False)
    timeline = Timeline(state)
    timeline.resize(900, timeline.height())

    monkeypatch.setattr(QPainter, "drawText", lambda painter, place, text: drawn.append(text))
    timeline.grab()
    assert 1 < len(drawn) < 20


def test_missing_frames_depend_on_the_requested_products():
    history = FrameHistory(4)
    history.record(0, Numbers(), patch=True)
    history.record(1, Numbers(status="ok"), patch=True)
    known = Numbers(status="ok", has_patch=True, area_m2=1e-4, force_n=2.0)
    history.record(2, known, patch=True)
    history.record(3, known, patch=False)
    assert list(history.missing(frozenset())) == []
    assert list(history.missing(frozenset({"estimate"}))) == [0]
    assert list(history.missing(frozenset({"estimate", "patch"}))) == [0, 1, 3]
    history.forget_patches()
    assert list(history.missing(frozenset({"patch"}))) == [0, 1, 2, 3]
    assert history.values["force_n"][2] == 2.0  # of all pressure, independent of the threshold


@pytest.fixture
def clock():
    made = PlayClock(np.arange(10) / 10.0 + 5.0)
    made.start(2, wall_s=100.0, speed=1.0)
    return made


@pytest.mark.parametrize(
    ("now_s", "loop", "due"),
    [
        (100.05, True, (2, 0, False)),
        (100.1, True, (3, 0, False)),
        (100.4, True, (6, 3, False)),  # a late call counts the skipped frames
        (100.7, False, (9, 6, True)),
        (100.75, True, (9, 6, False)),  # a loop begins one interval after the last frame
        (100.85, True, (0, 7, False)),
        (102.85, True, (0, 27, False)),  # several loops at once
    ],
)
def test_frames_due_in_real_time(clock, now_s, loop, due):
    assert clock.due(now_s, loop=loop) == due


@pytest.mark.parametrize("speed", [0.1, 0.5, 2.0, 8.0])
def test_clock_with_speed_single_frame_and_uneven_times(speed):
    for times, wait_s, frame in (
        (np.arange(10) / 10.0, 0.5, 5),
        (np.zeros(1), 0.5, 0),
        (np.array([0.0, 0.1, 1.0]), 0.9, 1),
    ):
        clock = PlayClock(times)
        clock.start(0, wall_s=0.0, speed=speed)
        assert clock.due(wait_s / speed, loop=False)[0] == frame


def test_every_frame_mode_compensates_only_small_delays():
    clock = PlayClock(np.arange(10) / 10.0)
    clock.start(0, 0.0, 1.0)
    assert clock.next_frame(0.05, loop=False) == (0, False)
    assert clock.next_frame(0.13, loop=False) == (1, False)
    assert clock.next_frame(0.201, loop=False) == (2, False)  # due at 0.2, not at 0.23
    assert clock.next_frame(5.0, loop=False) == (3, False)
    assert clock.next_frame(5.05, loop=False) == (3, False)
    clock.start(9, 6.0, 1.0)
    assert clock.next_frame(6.2, loop=False) == (9, True)
    assert clock.next_frame(6.2, loop=True) == (0, False)
