"""Sessions with live sources, unsaved sensors and objects; session files from the command line."""

import json
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from fakes import FRAMES, small_sensor
from live_bench import sensor_file
from window_driver import run_bubbleviz

from benchmarks.window.live_soak import free_port
from bubbleviz.errors import InputError
from bubbleviz.files import presets_folder
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.session_files.session_file import (
    SavedSession,
    UserFile,
    read_session,
    read_user_file,
)
from bubbleviz_ui.window_session import Startup, window_session
from tests.program import refusal


@contextmanager
def start(keep_in=None, saved=None):
    """The program as `bubbleviz [open SAVED]` starts it, with a fast built-in press."""
    file = None if keep_in is None else lambda: keep_in
    with window_session(Startup(small_sensor(), saved=saved), file) as session:
        session.window.show()
        yield session


# -- object -------------------------------------------------------------------------------------


def test_session_keeps_object_initial_pose_and_tracking_and_reports_a_missing_object(
    drive, files, open_press, tmp_path
):
    shutil.copy(presets_folder("objects") / "cylinder.ply", files / "stamp.ply")
    mine = drive()
    open_press(mine, frame=8)
    mine.window.files.open(files / "stamp.ply")
    pose = mine.window.pose
    mine.wait(lambda: pose.session.obj is not None)
    for box, value in zip(pose.start.places, (4.0, 1.0, 45.0), strict=True):
        mine.type(box, f"{value:g}")
    mine.click(pose.track)
    mine.window.session_saver.save_as(files / "look.bubbleviz")
    assert str(files) not in (files / "look.bubbleviz").read_text()
    shutil.move(files, tmp_path / "theirs")
    other = drive()
    other.window.files.open(tmp_path / "theirs" / "look.bubbleviz")
    theirs = other.window.pose
    other.wait(lambda: other.state.facts.frames == FRAMES and theirs.session.obj is not None)
    assert theirs.session.obj.name == "stamp"
    assert np.allclose(theirs.session.start[:3, 3], [4e-3, 1e-3, 45e-3])
    assert not theirs.search.isChecked() and theirs.start.places[2].value() == 45.0
    assert theirs.track.isChecked() and other.window.panels["pose"].isVisible()
    other.wait(lambda: theirs.session.pose is not None)  # registered in the frame shown
    other.wait(lambda: theirs.object.currentText() == "stamp.ply")
    # a missing object gives a message
    (tmp_path / "theirs" / "stamp.ply").unlink()
    other.seek(3)
    other.window.files.open(tmp_path / "theirs" / "look.bubbleviz")
    other.wait_for_message("stamp.ply is missing; the rest is restored")
    other.wait(lambda: other.state.frame == 8 and other.state.facts.frames == FRAMES)
    assert theirs.session.object_name is None


# -- unsaved sensors ----------------------------------------------------------------------------


@pytest.mark.long
def test_unsaved_sensor_is_restored_at_the_next_start(files, tmp_path):
    config = tmp_path / "config" / "session.json"
    with start(config) as session:
        session.window.controller.opening.use_sensor(small_sensor("edited", nodes=150))
        session.wait_for(lambda: session.controller.sensor.name == "edited", "opening")
    kept = list(config.parent.glob("session_sensor_*"))
    assert len(kept) == 1
    with start(config) as session:
        assert session.controller.sensor.name == "edited"
        assert session.controller.sensor.membrane.nodes == 150
        assert not session.window.message.isVisible() and not session.window.session_saver.recent
        session.window.controller.opening.use_sensor(load_sensor(files / "dome.toml"))
        session.wait_for(lambda: session.controller.sensor.name == "small dome", "opening")
    assert not list(config.parent.glob("session_sensor_*"))  # not needed any more


# -- live sources -------------------------------------------------------------------------------


def test_live_source_is_reconnected_at_the_next_start(qtbot, tmp_path):
    config = tmp_path / "session.json"
    live = single("synthetic:?frames=6", sensor_file(tmp_path))
    with start(config) as session:
        session.window.live_controller.connect_to(live)
        session.wait_for(lambda: bool(session.state.facts.grows), "connecting")
        session.state.change(kappa=2.0)
    with start(config) as session:
        session.wait_for(lambda: bool(session.state.facts.grows), "connecting again")
        assert session.state.facts.title == "synthetic:?frames=6"
        assert session.controller.sensor.name == "robot dome"
        assert session.state.settings.kappa == 2.0 and not session.window.message.isVisible()
        session.window.live.leave.click()  # by the user: not reconnected later
    assert json.loads(config.read_text())["session"]["live"] is None


@pytest.mark.long
def test_missing_live_source_gives_a_message_and_stays_in_the_session(qtbot, files, tmp_path):
    config = tmp_path / "session.json"
    rec = files / "press.mcap"
    live = single(f"replay:{rec}?loop=1", str(files / "dome.toml"))
    with start(config) as session:
        session.window.live_controller.connect_to(live)
        session.wait_for(lambda: bool(session.state.facts.grows), "connecting")
        session.window.session_saver.save_as(files / "live.bubbleviz")
    assert str(files) not in (files / "live.bubbleviz").read_text()
    rec.rename(tmp_path / "away.mcap")
    with start(config) as session:
        message = session.window.message
        session.wait_for(message.isVisible, "the message")
        assert "press.mcap" in message.label.text()
        assert not session.state.facts.grows and not session.state.facts.is_empty
        session.state.change(solver="fast")  # opens the same press again
        gone = session.controller.client.session
        session.wait_for(lambda: session.controller.client.session is not gone, "again")
        session.state.change(solver=None)
    assert read_user_file(config).session.live == live  # for the next start
    (tmp_path / "away.mcap").rename(rec)
    shutil.move(files, tmp_path / "theirs")
    with start(saved=tmp_path / "theirs" / "live.bubbleviz") as session:
        session.wait_for(lambda: bool(session.state.facts.grows), "connecting elsewhere")
        assert session.state.facts.title.startswith(f"replay:{tmp_path / 'theirs'}")


@pytest.mark.long
def test_robot_that_is_not_running_yet_is_awaited(qtbot, files, tmp_path):
    config = tmp_path / "session.json"
    robot = single(f"zenoh:tcp/127.0.0.1:{free_port()}", str(files / "dome.toml"))
    config.write_text(UserFile(session=SavedSession(live=robot)).model_dump_json())
    with start(config) as session:
        bar = session.window.live
        session.wait_for(bar.isVisible, "the bar")
        assert not session.state.facts.is_empty  # the built-in press in the meantime
        session.window.files.open(files / "dome.toml")  # another sensor, same source
        session.wait_for(lambda: session.controller.sensor.file == "dome.toml", "the sensor")
        bar.leave.click()
        assert not bar.isVisible()
    assert read_user_file(config).session.live == robot
    with start(config) as session:
        session.wait_for(session.window.live.isVisible, "the bar")
        session.window.files.open(files / "press.mcap")
        session.wait_for(lambda: session.state.facts.frames == FRAMES, "the recording")
        assert session.window.live_controller.connection is None  # will not replace it
        assert not session.window.live.isVisible()
    assert read_user_file(config).session.live is None


def test_session_of_a_temporarily_missing_recording_is_kept(qtbot, files, tmp_path):
    config, rec = tmp_path / "session.json", files / "press.mcap"
    with window_session(
        Startup(load_sensor(files / "dome.toml"), rec, 5), lambda: config
    ) as session:
        session.state.set_markers((2, 9))
        session.state.change(kappa=1.75)
    rec.rename(tmp_path / "away.mcap")
    with start(config) as session:
        assert "press.mcap is missing" in session.window.message.label.text()
        assert session.state.settings.kappa == 1.75 and session.state.facts.title != "press.mcap"
    (tmp_path / "away.mcap").rename(rec)
    with start(config) as session:
        assert session.state.facts.frames == FRAMES and session.state.frame == 5
        assert session.state.markers == (2, 9)


# -- the command line ---------------------------------------------------------------------------


@pytest.mark.long
def test_the_command_line_opens_a_session(drive, files, open_press, tmp_path):
    mine = drive()
    open_press(mine, frame=8)
    mine.state.set_markers((2,))
    mine.window.session_saver.save_as(files / "look.bubbleviz")
    with start(saved=files / "look.bubbleviz") as session:
        assert session.state.facts.frames == FRAMES and session.state.frame == 8
        assert session.state.markers == (2,) and not session.window.message.isVisible()
        assert Path(session.window.session_saver.recent[0]).name in ("press.mcap", "dome.toml")
    done = run_bubbleviz("open", str(files / "look.bubbleviz"), TMPDIR=str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "wrote" in done.stdout


VIEWPOINT = '{"camera": {"position": [0,0,1], "focal_point": [0,0,0], "up": UP, "view_angle": 30}}'
UPWARDS = ("[0, 0, 0]", "[0, 0, 1]", "[1e308, 0, 0]")
TEXTS = ("", "[]", '{"schema_version": 9}', '{"live": {"a": 1}}', '{"frame": -1}')


@pytest.mark.parametrize(
    "text", [None, *TEXTS, *(VIEWPOINT.replace("UP", each) for each in UPWARDS)]
)
def test_invalid_session_file_gives_one_sentence(tmp_path, text):
    bad = tmp_path / "bad.bubbleviz"
    if text is not None:
        bad.write_text(text)
    with pytest.raises(InputError, match=r"bad\.bubbleviz") as refused:
        read_session(bad)
    assert len(str(refused.value).splitlines()) == 1


def test_missing_session_or_session_with_frame_option_is_an_error(tmp_path):
    for words, told in ([], "a.bubbleviz"), (["--frame", "3"], "--frame"):
        assert told in refusal("open", tmp_path / "a.bubbleviz", *words)
