"""Two sensors in one view: both solved and drawn, the panels follow the chosen one."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fakes import DentSource, record
from live_bench import IMAGE, contents, robot_sensor, sensor_file, two
from PySide6.QtCore import Qt
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
from vtkmodules.vtkRenderingCore import vtkAssembly
from window_driver import props

from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layer import Surface


def paired(open_bench):
    """A window on two sensors, both of which have shown something."""
    bench = open_bench()
    bench.connect(two(bench.folder))
    bench.wait(lambda: bench.window.pair.second.opened is not None)
    return bench


def connect_played(bench, frames):
    """Connect two sensors, of which the other plays these frames; the membranes alone are drawn."""
    preset, played = two(bench.folder), record(bench.folder / "other.mcap", frames)
    second = preset.sensors[1].model_copy(update={"source": f"replay:{played}?loop=true"})
    bench.state.change(layers=frozenset({"membrane"}))
    bench.connect(preset.model_copy(update={"sensors": (preset.sensors[0], second)}))


def other(bench):
    """Number of the frame that the other sensor shows."""
    return bench.window.pair.second.result.frame.index


def world_camera(bench):
    """Place, focus and up of the view's camera in the world, (3, 3)."""
    T = bench.run.preset.sensors[bench.live_controller.selected].T_W_B
    camera = bench.window.view.camera
    points = np.array([camera.position, camera.focal_point]) @ T[:3, :3].T + T[:3, 3]
    return np.vstack([points, T[:3, :3] @ camera.up])


def drawing(bench):
    """What the other sensor has in the view."""
    (found,) = (prop for prop in props(bench) if isinstance(prop, vtkAssembly))
    return found


def drawn(bench):
    """Its ends, (3, 2)."""
    return np.array(drawing(bench).GetBounds()).reshape(3, 2)


def of_the_other(bench):
    """Pixels in the colour of the other sensor's rim."""
    colour = bench.run.preset.sensors[1].colour
    own = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    away = np.abs(bench.pixels().astype(int) - own).max(axis=2)
    return int(np.count_nonzero(away < 12))


def test_both_are_solved_drawn_where_they_are_and_whole_in_a_low_view(open_bench):
    bench = paired(open_bench)
    bench.window.resize(1400, 640)
    bench.window.use_scene(load_scene("review"))
    bench.state.change(layers=frozenset({"rim", "membrane"}))
    bench.follow(2)
    bench.painted_anew()
    view = bench.window.view
    assert view.width() > 2 * view.height()
    own = np.asarray(bench.window.scene.layers["membrane"].actor.mapper.dataset.points)
    angle, radius = np.linspace(0.0, 2.0 * np.pi, 60), robot_sensor().membrane.rim_radius_m
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(60, 0.12)], axis=1)
    for points in (own, rim):
        assert np.abs(view.projected(points)[:, 1]).max() < 1.0
    # solved in threads of their own and drawn where they are
    assert sum(t.name.startswith("solver") for t in threading.enumerate()) == 2
    before = other(bench)
    bench.follow(5)
    bench.wait(lambda: other(bench) > before + 3)
    # The other's dome points at ours from 120 mm away, along our own z. Its rim is the same in
    # every frame; the force arrow, for one, is longer or shorter.
    dome = robot_sensor().membrane
    bench.state.change(layers=frozenset({"rim"}))
    radius = dome.rim_radius_m
    expected = [[-radius, radius], [-radius, radius], [0.12, 0.12]]
    np.testing.assert_allclose(drawn(bench), expected, atol=3e-3)
    bench.state.change(layers=frozenset({"rim", "membrane"}))
    bench.wait(lambda: drawn(bench)[2, 0] < 0.12 - 0.5 * dome.height_m)
    bench.painted_anew()
    assert of_the_other(bench) > 50
    bench.window.pair.end()
    bench.painted_anew()
    assert of_the_other(bench) == 0


@pytest.mark.long
def test_time_is_shared(open_bench):
    bench = paired(open_bench)
    bench.follow(8)
    bench.state.seek(bench.state.frame - 5)
    bench.wait(lambda: bench.shown == bench.state.frame)
    now = bench.state.facts.times_s[bench.state.frame]
    frames = bench.run.frames[1]
    bench.wait(lambda: other(bench) == frames.at(now))
    shown, newest = other(bench), len(frames)
    bench.messages_come(8, sensor=1)
    assert other(bench) == shown and len(frames) <= newest + 1
    bench.state.freeze(False)
    bench.wait(lambda: other(bench) > newest + 2)


def test_both_stop_at_one_moment_and_the_panels_turn_to_the_other_and_back(open_bench):
    """Whatever was asked for before and comes after."""
    bench = paired(open_bench)
    frames = bench.run.frames[1]
    for _ in range(2):
        bench.follow(3)
        bench.state.set_playing(False)
        bench.messages_come(3, sensor=1)
        bench.wait(lambda: bench.shown == bench.state.frame and bench.window.controller.cold_solved)
        now = bench.state.facts.times_s[bench.state.frame]
        bench.wait(lambda now=now: other(bench) == frames.at(now))
        bench.state.set_playing(True)
    # the panels turn to the other sensor and back
    bench.follow(5)
    first, worker = bench.state.history, bench.window.controller.worker
    known = len(first)
    assert bench.state.facts.title == "Two, left"
    bench.window.live.sensors[1].click()
    assert bench.live_controller.selected == 1 and bench.state.facts.title == "Two, right"
    assert bench.window.controller.worker is not worker
    assert bench.state.history is not first
    bench.follow(5)
    assert np.isfinite(bench.state.history.values["residual_m"][-3:-1]).all()
    bench.key(Qt.Key.Key_B)
    assert bench.live_controller.selected == 0 and bench.window.controller.worker is worker
    assert bench.state.history is first and len(first) > known
    bench.follow(3)
    assert np.isfinite(first.values["residual_m"][1 : bench.shown]).all()
    # the view does not move in the world
    bench.window.view.camera.position = (0.3, -0.2, 0.35)
    before = world_camera(bench)
    bench.live_controller.switch_sensor()
    np.testing.assert_allclose(world_camera(bench), before, atol=1e-9)
    bench.window.scene.reset_view()
    np.testing.assert_allclose(world_camera(bench)[2], [0.0, 0.0, 1.0], atol=1e-9)
    assert sum(t.name.startswith("solver") for t in threading.enumerate()) == 2


@pytest.mark.long
def test_one_recording_has_both_and_one_sensor_again_costs_nothing(open_bench):
    bench = paired(open_bench)
    bench.record()
    bench.follow(4)
    found = contents(bench.stop())
    by_channel: dict[int, list[int]] = {}
    for message in found[IMAGE]:
        by_channel.setdefault(message.channel_id, []).append(message.sequence)
    assert len(by_channel) == 2
    for numbers in by_channel.values():
        assert np.array_equal(numbers, np.arange(numbers[0], numbers[-1] + 1))
    alone = two(bench.folder)
    bench.connect(alone.model_copy(update={"sensors": alone.sensors[:1]}))
    bench.wait(lambda: bench.state.facts.title.startswith("synthetic:"))
    bench.follow(3)
    assert bench.window.pair.second is None and not bench.window.live.sensors
    assert not drawing(bench).GetVisibility()
    assert sum(t.name.startswith("solver") for t in threading.enumerate()) == 1
    bench.window.scene.reset_view()  # with nothing beside it in view
    middle = [0.0, 0.0, 0.5 * robot_sensor().membrane.height_m]
    np.testing.assert_allclose(bench.window.view.camera.focal_point, middle, atol=1e-3)


def ends_kpa(bench):
    """Upper end of the pressure scale: what the bar states, and by which both are coloured."""
    (bar,) = (
        prop
        for prop in props(bench)
        if isinstance(prop, vtkScalarBarActor) and "pressure" in prop.GetTitle()
    )
    parts = drawing(bench).GetParts()
    (membrane,) = (
        part.GetMapper()
        for part in (parts.GetItemAsObject(k) for k in range(parts.GetNumberOfItems()))
        if part.GetVisibility() and part.GetMapper().GetArrayName() == Surface.PRESSURE
    )
    own = bench.window.scene.layers["membrane"].actor.mapper
    return bar.GetLookupTable().GetRange()[1], own.GetScalarRange()[1], membrane.GetScalarRange()[1]


def test_both_are_coloured_on_the_scale_that_the_bar_states(open_bench):
    """In each picture, the first ones too, also while one is pressed harder than the other.

    And right after the chosen one has another sensor file, while the other stands still.
    """
    bench, seen, pressed = open_bench(), list[tuple[float, float, float]](), list[float]()
    pair = bench.window.pair

    def look():
        if pair.drawing is not None and drawing(bench).GetVisibility():
            seen.append(ends_kpa(bench))
            estimate = pair.second.result.estimate
            sure = estimate is not None and estimate.status == "ok"
            pressed.append(1e-3 * estimate.contact_pressure_pa.max() if sure else 0.0)

    bench.window.view.rendered.connect(look)
    connect_played(bench, DentSource(robot_sensor()))
    for _ in range(2):
        before = len(seen)
        bench.wait(lambda before=before: len(seen) > before + 8)
        bench.live_controller.switch_sensor()
    assert all(len(set(ends)) == 1 for ends in seen), seen
    bench.wait(lambda: len(set(seen)) > 1)  # the scale has changed
    bench.wait(lambda: pressed[-1] > 4.0)
    bench.state.freeze(True)
    bench.painted_anew()
    file = Path(sensor_file(bench.folder, "softer", gauge_pressure_pa=1500.0))
    bench.window.open_file(file)
    bench.wait(lambda: "softer.toml" in bench.window.windowTitle())
    bench.painted_anew()
    assert all(len(set(ends)) == 1 for ends in seen), seen
    assert all(peak <= ends[0] for peak, ends in zip(pressed, seen, strict=True))


def test_the_other_sensor_says_that_it_is_not_to_be_trusted(open_bench):
    """Its membrane has the colour of that, and its button the word and the reason."""
    bench = open_bench()
    # no membrane of this sensor is half as far again
    far = (replace(f, depth_m=np.float32(1.5) * f.depth_m) for f in DentSource(robot_sensor()))
    connect_played(bench, far)
    buttons = lambda: [button.text() for button in bench.window.live.sensors]  # noqa: E731
    bench.wait(lambda: buttons() == ["● left", "● right: implausible"])
    assert "far from this membrane" in bench.window.live.sensors[1].toolTip() or (
        "from any shape" in bench.window.live.sensors[1].toolTip()
    )
    bench.painted_anew()
    own = [int(theme.UNTRUSTED[k : k + 2], 16) for k in (1, 3, 5)]
    hue = bench.pixels().astype(float)
    like = hue @ own / (np.linalg.norm(hue, axis=2) * np.linalg.norm(own) + 1e-9)
    assert np.count_nonzero(like > 0.99) > 200  # shaded, so by its hue
