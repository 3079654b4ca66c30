"""Two sensors in one view: both solved and drawn, panels show the selected one."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fakes import DentSource, record
from live_bench import IMAGE, messages_by_type, robot_sensor, sensor_file, sensor_pair_preset
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog
from vtkmodules.vtkRenderingCore import vtkAssembly
from window_driver import clipped_texts, colour_bar, view_texts, vtk_props

from bubbleviz.recordings import RecordingWriter
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layer import Surface


def paired(open_bench):
    """A window with two sensors, both with a result."""
    bench = open_bench()
    bench.connect(sensor_pair_preset(bench.folder))
    bench.wait(lambda: bench.second.opened is not None)
    return bench


def connect_played(bench, frames, name="other"):
    """Connect two sensors, the second replaying these frames; only membranes are drawn."""
    preset, played = sensor_pair_preset(bench.folder), record(bench.folder / f"{name}.mcap", frames)
    second = preset.sensors[1].model_copy(update={"source": f"replay:{played}?loop=true"})
    bench.state.change(layers=frozenset({"membrane"}))
    bench.connect(preset.model_copy(update={"sensors": (preset.sensors[0], second)}))


def other(bench):
    """Frame shown of the other sensor."""
    return bench.second.result.frame.index


def world_camera(bench):
    """Position, focal point and up vector of the camera in the world, (3, 3)."""
    T = bench.run.preset.sensors[bench.window.controller.chosen].T_W_B
    camera = bench.window.view.camera
    points = np.array([camera.position, camera.focal_point]) @ T[:3, :3].T + T[:3, 3]
    return np.vstack([points, T[:3, :3] @ camera.up])


def drawing(bench):
    """VTK props of the other sensor."""
    (found,) = (prop for prop in vtk_props(bench) if isinstance(prop, vtkAssembly))
    return found


def drawn(bench):
    """Bounding box, (3, 2)."""
    return np.array(drawing(bench).GetBounds()).reshape(3, 2)


def of_the_other(bench):
    """Pixels in the colour of the other sensor's rim."""
    colour = bench.run.preset.sensors[1].colour
    own = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    away = np.abs(bench.pixels().astype(int) - own).max(axis=2)
    return int(np.count_nonzero(away < 12))


@pytest.mark.long
def test_both_sensors_share_the_time(open_bench):
    bench = paired(open_bench)
    bench.wait_for_frames(8)
    bench.state.seek(bench.state.frame - 5)
    bench.wait(lambda: bench.shown_frame == bench.state.frame)
    now = bench.state.facts.times_s[bench.state.frame]
    frames = bench.run.frames[1]
    bench.wait(lambda: other(bench) == frames.at(now))
    shown, newest = other(bench), len(frames)
    bench.wait_for_messages(8, sensor=1)
    assert other(bench) == shown and len(frames) <= newest + 1
    bench.state.freeze(False)
    bench.wait(lambda: other(bench) > newest + 2)


def test_both_sensors_are_solved_paused_at_the_same_time_switched_and_placed(open_bench):
    """Independent of requests pending before."""
    bench = paired(open_bench)
    frames = bench.run.frames[1]
    for _ in range(2):
        bench.wait_for_frames(1)
        bench.state.set_playing(False)
        bench.wait_for_messages(3, sensor=1)
        bench.wait(
            lambda: bench.shown_frame == bench.state.frame and bench.window.controller.cold_solved
        )
        now = bench.state.facts.times_s[bench.state.frame]
        bench.wait(lambda now=now: other(bench) == frames.at(now))
        bench.state.set_playing(True)
    # panels switch to the other sensor and back
    bench.wait_for_frames(1)
    first, worker = bench.state.history, bench.window.controller.worker
    known = len(first)
    assert bench.state.facts.title == "Two, left"
    bench.window.live.sensors[1].click()
    assert bench.window.controller.chosen == 1 and bench.state.facts.title == "Two, right"
    assert bench.window.controller.worker is not worker
    assert bench.state.history is not first
    bench.wait_for_frames(5)
    assert np.isfinite(bench.state.history.values["residual_m"][-3:-1]).all()
    bench.key(Qt.Key.Key_B)
    assert bench.window.controller.chosen == 0 and bench.window.controller.worker is worker
    assert bench.state.history is first and len(first) > known
    bench.wait_for_frames(3)
    assert np.isfinite(first.values["residual_m"][1 : bench.shown_frame]).all()
    # the camera does not move in the world
    bench.window.view.camera.position = (0.3, -0.2, 0.35)
    before = world_camera(bench)
    bench.window.group.choose_next()
    np.testing.assert_allclose(world_camera(bench), before, atol=1e-9)
    bench.window.scene.reset_view()
    np.testing.assert_allclose(world_camera(bench)[2], [0.0, 0.0, 1.0], atol=1e-9)
    assert sum(t.name.startswith("solver") for t in threading.enumerate()) == 2
    # the buttons of sensors need no row of their own in a narrow bar
    bench.window.resize(675, 427)
    bench.wait_for_redraw()
    bar = bench.window.live
    assert bar.width() < bar.sizeHint().width() and len(bar.sensors) == 2
    places = [each.mapTo(bar, each.rect().center()).y() for each in (bar.state, *bar.sensors)]
    assert np.ptp(places) <= 1
    # placed and fully visible
    bench.window.resize(1400, 640)
    bench.window.use_scene(load_scene("review"))
    bench.state.change(layers=frozenset({"rim", "membrane"}))
    bench.wait_for_redraw()
    view = bench.window.view
    assert view.width() > 2 * view.height()
    own = np.asarray(bench.window.scene.layers["membrane"].actor.mapper.GetInput().points)
    angle, radius = np.linspace(0.0, 2.0 * np.pi, 60), robot_sensor().membrane.rim_radius_m
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(60, 0.12)], axis=1)
    for points in (own, rim):
        assert np.abs(view.projected(points)[:, 1]).max() < 1.0
    # solved in separate threads and drawn at their poses
    assert sum(t.name.startswith("solver") for t in threading.enumerate()) == 2
    before = other(bench)
    bench.wait_for_frames(3)
    bench.wait(lambda: other(bench) > before + 2)
    # The other's dome points at ours from 120 mm away, along our own z. Its rim is the same in
    # every frame; the force arrow, for one, is longer or shorter.
    dome = robot_sensor().membrane
    bench.state.change(layers=frozenset({"rim"}))
    radius = dome.rim_radius_m
    expected = [[-radius, radius], [-radius, radius], [0.12, 0.12]]
    np.testing.assert_allclose(drawn(bench), expected, atol=3e-3)
    bench.state.change(layers=frozenset({"rim", "membrane"}))
    bench.wait(lambda: drawn(bench)[2, 0] < 0.12 - 0.5 * dome.height_m)
    bench.wait_for_redraw()
    assert of_the_other(bench) > 50
    bench.window.controller.regroup()
    bench.wait_for_redraw()
    assert of_the_other(bench) == 0


def test_a_sensor_that_fails_is_named_once_and_solved_again(open_bench):
    bench = paired(open_bench)
    errors = lambda: [m.text for m in bench.window.messages.all if m.kind == "error"]  # noqa: E731
    for number, name in enumerate(("left", "right")):
        client = bench.window.controller.clients[number]
        pipeline, known = client.solver.current.pipeline, len(errors())
        solve, calls = pipeline.process, []

        def fail(*_, calls=calls):
            calls.append(_)
            raise ZeroDivisionError("a bug")

        pipeline.process = fail
        bench.wait(lambda calls=calls: len(calls) > 5)
        pipeline.process = solve
        before = client.result.frame.index
        bench.wait(lambda client=client, before=before: client.result.frame.index > before + 2)
        assert errors()[known:] == [f"{name}: ZeroDivisionError: a bug"]


def test_disconnected_sensor_is_not_opened_again_with_another_sensor_file(open_bench):
    bench = paired(open_bench)
    bench.click(bench.window.live.leave)
    assert bench.second is None
    bench.window.files.open(Path(sensor_file(bench.folder, "softer", gauge_pressure_pa=1500.0)))
    bench.wait(lambda: "softer.toml" in bench.window.windowTitle())
    bench.wait_for_redraw()
    assert bench.second is None and not bench.window.live.sensors
    assert not drawing(bench).GetVisibility()


@pytest.mark.long
def test_recording_of_both_sensors_and_return_to_one(open_bench):
    bench = paired(open_bench)
    bench.record()
    bench.wait_for_frames(4)
    found = messages_by_type(bench.stop())
    by_channel: dict[int, list[int]] = {}
    for message in found[IMAGE]:
        by_channel.setdefault(message.channel_id, []).append(message.sequence)
    assert len(by_channel) == 2
    for numbers in by_channel.values():
        assert np.array_equal(numbers, np.arange(numbers[0], numbers[-1] + 1))
    alone = sensor_pair_preset(bench.folder)
    bench.connect(alone.model_copy(update={"sensors": alone.sensors[:1]}))
    bench.wait(lambda: bench.state.facts.title.startswith("synthetic:"))
    bench.wait_for_frames(3)
    assert bench.second is None and not bench.window.live.sensors
    assert not drawing(bench).GetVisibility()
    assert sum(t.name.startswith("solver") for t in threading.enumerate()) == 1
    bench.window.scene.reset_view()  # without the other sensor
    middle = [0.0, 0.0, 0.5 * robot_sensor().membrane.height_m]
    np.testing.assert_allclose(bench.window.view.camera.focal_point, middle, atol=1e-3)


def ends_kpa(bench):
    """Upper ends of the pressure scale: of the colour bar, and of both membranes."""
    parts = drawing(bench).GetParts()
    (membrane,) = (
        part.GetMapper()
        for part in (parts.GetItemAsObject(k) for k in range(parts.GetNumberOfItems()))
        if part.GetVisibility() and part.GetMapper().GetArrayName() == Surface.PRESSURE
    )
    own = bench.window.scene.layers["membrane"].actor.mapper
    bar = colour_bar(bench, "pressure").GetLookupTable()
    return bar.GetRange()[1], own.GetScalarRange()[1], membrane.GetScalarRange()[1]


def test_both_sensors_use_the_scale_of_the_colour_bar_and_untrusted_results_their_colour(
    open_bench,
):
    """In every picture from the first on, also while one is pressed harder.

    And right after the chosen one has another sensor file, while the other stands still.
    """
    bench, seen, pressed = open_bench(), list[tuple[float, float, float]](), list[float]()

    def look():
        if bench.window.group.drawings and drawing(bench).GetVisibility():
            seen.append(ends_kpa(bench))
            estimate = bench.second.result.estimate
            sure = estimate is not None and estimate.status == "ok"
            pressed.append(1e-3 * estimate.contact_pressure_pa.max() if sure else 0.0)

    bench.window.view.rendered.connect(look)
    connect_played(bench, DentSource(robot_sensor()))
    for _ in range(2):
        before = len(seen)
        bench.wait(lambda before=before: len(seen) > before + 4)
        bench.window.group.choose_next()
    assert all(len(set(ends)) == 1 for ends in seen), seen
    bench.wait(lambda: len(set(seen)) > 1)  # the scale has changed
    bench.wait(lambda: pressed[-1] > 4.0)
    bench.state.freeze(True)
    bench.wait_for_redraw()
    file = Path(sensor_file(bench.folder, "softer", gauge_pressure_pa=1500.0))
    bench.window.files.open(file)
    bench.wait(lambda: "softer.toml" in bench.window.windowTitle())
    bench.wait_for_redraw()
    assert all(len(set(ends)) == 1 for ends in seen), seen
    assert all(peak <= ends[0] for peak, ends in zip(pressed, seen, strict=True))
    # an untrusted result: the membrane has its colour, the button shows status and reason
    # implausible: 1.5 times the distance
    far = (replace(f, depth_m=np.float32(1.5) * f.depth_m) for f in DentSource(robot_sensor()))
    connect_played(bench, far, "far")
    buttons = lambda: [button.text() for button in bench.window.live.sensors]  # noqa: E731
    bench.wait(lambda: buttons() == ["● left", "● right: implausible"])
    assert "do not fit this membrane" in bench.window.live.sensors[1].toolTip() or (
        "from any shape" in bench.window.live.sensors[1].toolTip()
    )
    bench.wait_for_redraw()
    own = [int(theme.UNTRUSTED[k : k + 2], 16) for k in (1, 3, 5)]
    hue = bench.pixels().astype(float)
    like = hue @ own / (np.linalg.norm(hue, axis=2) * np.linalg.norm(own) + 1e-9)
    assert np.count_nonzero(like > 0.99) > 200  # compared by hue, as it is shaded


def two_recordings(folder, frames=8):
    """Recordings of two sensors, the second begun two frames later, and their sensor file."""
    file, source = sensor_file(folder), DentSource(robot_sensor())
    begun_ns = 1_790_000_000_000_000_000
    paths = []
    for name, first in (("left", 0), ("right", 2)):
        paths.append(folder / f"{name}.mcap")
        with RecordingWriter(paths[-1]) as writer:
            for k in range(first, first + frames):
                frame = source[k]
                stamp_ns = begun_ns + round(frame.time_s * 1e9)
                writer.write(replace(frame, stamp_ns=stamp_ns, arrival_ns=stamp_ns))
    return [*paths, Path(file)]


def shown_pair(bench, frame):
    """Wait until a frame of the first recording and one of the other are shown; those."""
    bench.wait(lambda: bench.second is not None)
    bench.wait(lambda: bench.second.opened is not None)
    bench.state.set_playing(False)
    bench.state.seek(frame)
    bench.wait_until_shown()
    bench.wait(lambda: not bench.second.worker.busy)
    bench.wait_for_redraw()
    return bench.result.frame.index, other(bench)


def force_texts(bench):
    """The readout's headline, and the force in the status bar."""
    return view_texts(bench)[0], bench.window.status.labels["force"].text()


def named_sensors(bench):
    return {text.partition(": ")[0] for text in force_texts(bench)}


def test_two_recordings_dropped_or_chosen_are_two_sensors_at_the_same_time(open_bench, monkeypatch):
    bench = open_bench()
    first, second, file = two_recordings(bench.folder)
    bench.open("empty", lambda _: DentSource(robot_sensor()), robot_sensor())
    bench.wait(lambda: not bench.state.facts.is_empty)
    bench.drop(first, second, file)
    bench.wait(lambda: bench.state.facts.title == "left.mcap")
    for frame in (5, 2, 7):
        assert shown_pair(bench, frame) == (frame, frame - 2)
    # beside each other, and both in the view
    assert drawing(bench).GetVisibility()
    own = np.asarray(bench.window.scene.layers["membrane"].actor.mapper.GetInput().points)
    assert drawn(bench)[0, 0] > own[:, 0].mean() and drawn(bench)[0, 1] > own[:, 0].max()
    # a click shows the other one in the panels, at its own frame
    # readout and status bar say whose force it is
    bar = bench.window.live
    assert bar.isVisible() and [button.text() for button in bar.sensors] == ["● left", "● right"]
    assert named_sensors(bench) == {"left"}
    bench.click(bar.sensors[1])
    bench.wait(lambda: bench.state.facts.title == "right.mcap")
    assert shown_pair(bench, 3) == (3, 5)
    assert named_sensors(bench) == {"right"} and not clipped_texts(bench.window.status)
    # reading the files again keeps both
    bench.trigger("File › Reload")
    bench.window.group.choose_next()  # has no effect before they are open
    bench.wait(lambda: not bench.window.controller.opening.busy)
    assert shown_pair(bench, 4) == (4, 6) and drawing(bench).GetVisibility()
    # playback moves both
    bench.state.seek(0)
    bench.state.set_playing(True)
    bench.wait(lambda: bench.result.frame.index > 3 and other(bench) > 3)
    bench.state.set_playing(False)
    # another recording alone removes the second
    bench.drop(first)
    bench.wait(lambda: bench.second is None)
    assert not drawing(bench).GetVisibility() and not bar.isVisible()
    bench.wait_until_shown()
    assert not any("right" in text for text in force_texts(bench))
    # two recordings chosen in the open dialog
    chosen = [str(first), str(second)]
    monkeypatch.setattr(QFileDialog, "getOpenFileNames", lambda *_, **__: (chosen, ""))
    bench.trigger("File › Open recording")
    bench.wait(lambda: bench.state.facts.title == "left.mcap")
    assert shown_pair(bench, 4) == (4, 2)
