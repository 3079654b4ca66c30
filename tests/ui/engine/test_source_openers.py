"""Simulated recordings and their ground truth in the window."""

import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from click.testing import CliRunner
from fakes import DentSource, record
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog
from window_driver import run_bubbleviz

from bubbleviz.api.simulating import Simulation
from bubbleviz.cli.command_line import main
from bubbleviz.errors import UnknownCameraError
from bubbleviz.live import Recorder
from bubbleviz.recordings import FrameMessages
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor, save_sensor, sensor_to_toml
from bubbleviz.simulation import DepthNoise, SyntheticSource
from bubbleviz_ui import panel_window
from bubbleviz_ui.engine.source import SYNTHETIC, Source
from bubbleviz_ui.engine.worker import Failed
from bubbleviz_ui.window_session import Startup, window_session

FRAMES = 3


@pytest.fixture(scope="module")
def files(sensor, tmp_path_factory):
    """A folder with a simulated press, its ground truth under another name, and the sensor file."""
    folder = tmp_path_factory.mktemp("simulated")
    poses = np.repeat(np.eye(4)[None], FRAMES, axis=0)
    poses[:, 2, 3] = (0.045, 0.042, 0.040)
    noise = DepthNoise(relative=0.001)
    source = SyntheticSource(sensor, load_object("cylinder"), poses, noise, nodes=800)
    Simulation(source).save(folder / "sim.mcap", folder / "what_is_true.npz")
    (folder / "dome.toml").write_text(sensor_to_toml(sensor))
    return folder


def opened(drive, sensor, path):
    """A window on a recording with the Threshold panel open."""
    driver = drive(Source.of_recording(path), sensor, frame=2)
    driver.show("threshold")
    driver.wait(lambda: driver.inspection.kappa_curve is not None)
    return driver


def test_a_preset_is_named_where_another_sensor_file_was_used_last(drive, tmp_path, monkeypatch):
    preset, own = load_sensor("pico_flexx_75mm"), tmp_path / "mine.toml"
    own.write_text(sensor_to_toml(preset))
    above = np.eye(4)[None].copy()
    above[0, 2, 3] = 0.1
    source = SyntheticSource(preset, load_object("cylinder"), above, DepthNoise(), nodes=300)
    Simulation(source).save(tmp_path / "rec.mcap", tmp_path / "truth.npz")
    used = {(preset.camera.width, preset.camera.height): own}
    monkeypatch.setattr(panel_window, "last_sensor", used.get)
    driver = drive(DentSource)
    notice, title = driver.window.notice, driver.window.windowTitle
    driver.drop(tmp_path / "rec.mcap")
    driver.wait(lambda: "(preset)" in title())
    assert notice.isVisible() and notice.label.text() == "A preset is in use instead of mine.toml"
    driver.click(notice.open)
    driver.wait(lambda: "(mine.toml)" in title())


def says_iou(driver):
    curve = driver.window.threshold.curve
    return curve is not None and "IoU" in curve.label.text


def test_ground_truth_is_saved_in_the_session_and_markers_are_on_the_timeline(
    drive, sensor, files, tmp_path
):
    driver = opened(drive, sensor, files / "sim.mcap")
    driver.wait_until_shown()
    assert not says_iou(driver)
    driver.drop(files / "what_is_true.npz")
    driver.wait(lambda: says_iou(driver))
    assert driver.state.frame == 2
    curve = driver.inspection.kappa_curve
    assert curve.iou.max() > 0.7  # of a coarse mesh
    driver.show("compare")
    values = driver.window.compare.a.values
    driver.wait(lambda: values["iou"].text() not in ("", "–"))
    assert float(values["iou"].text()) > 0.5
    driver.window.session_saver.save_as(files / "look.bubbleviz")
    other = drive()
    other.window.files.open(files / "look.bubbleviz")
    other.wait(lambda: other.state.facts.frames == FRAMES)
    other.window.panels["threshold"].raise_()  # above Compare
    other.wait(lambda: says_iou(other))
    # markers and notes of another recording are on the timeline
    source, recorder = DentSource(sensor), Recorder()
    recorder.start(tmp_path / "marked.mcap")
    begun = 1_790_000_000_000_000_000
    for k, frame in enumerate(source):
        at = begun + round(source.times_s[k] * 1e9)
        for message in FrameMessages().of(frame, at):
            recorder.push(message._replace(stamp_ns=at, arrival_ns=at))
        if k in (3, 7):
            recorder.mark("slipped here" if k == 7 else "marker at frame 3", at)
    assert not recorder.stop().problem
    driver.drop(tmp_path / "marked.mcap")
    driver.wait(lambda: driver.state.facts.title == "marked.mcap")
    driver.state.set_playing(False)
    driver.seek(2)
    driver.wait(lambda: driver.state.markers == (3, 7))
    assert "marked: slipped here" in driver.window.playback.timeline.tip(7)
    assert "marked" not in driver.window.playback.timeline.tip(6)
    driver.key(Qt.Key.Key_PageDown)
    driver.wait(lambda: driver.state.frame == 3)


def test_ground_truth_is_opened_found_or_refused_as_of_another_recording(
    drive, sensor, files, tmp_path, monkeypatch
):
    menu, name = "File › Open ground truth", str(files / "what_is_true.npz")
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (name, ""))
    driver = drive()
    driver.trigger(menu)  # the open source is not a recording
    driver.wait_for_message("first open that of the simulation")
    # recording, sensor file and ground truth dropped together
    driver.show("threshold")
    driver.drop(files / "what_is_true.npz", files / "sim.mcap", files / "dome.toml")
    driver.wait(lambda: driver.state.facts.frames == FRAMES)
    assert driver.window.controller.sensor.file == "dome.toml"
    driver.state.set_playing(False)
    driver.wait(lambda: says_iou(driver))
    # without ground truth there is no IoU until it is opened
    driver.open("sim.mcap", Source.of_recording(files / "sim.mcap"), sensor, frame=2, playing=False)
    driver.wait(lambda: not says_iou(driver))
    driver.wait_until_shown()
    arrays = dict(np.load(files / "what_is_true.npz"))
    np.savez(tmp_path / "other.npz", **{**arrays, "time_s": 1.5 * arrays["time_s"]})
    driver.drop(tmp_path / "other.npz")
    driver.wait_for_message("other.npz: belongs to another recording")
    assert driver.state.facts.frames == FRAMES and driver.state.frame == 2 and not says_iou(driver)
    driver.trigger(menu)
    driver.wait(lambda: says_iou(driver))
    # one next to the recording is found, or reported as foreign
    while driver.window.message.isVisible():
        driver.click(driver.window.message.dismiss)
    driver.show_source(DentSource, sensor)
    shutil.copy(files / "sim.mcap", tmp_path)
    shutil.copy(files / "what_is_true.npz", tmp_path / "sim.npz")
    driver.drop(tmp_path / "sim.mcap")
    driver.wait(lambda: driver.state.facts.frames == FRAMES)
    driver.wait(lambda: says_iou(driver))
    truth = {name: array[:-1] for name, array in np.load(files / "what_is_true.npz").items()}
    np.savez(tmp_path / "sim.npz", **truth)
    driver.trigger("File › Reload")
    driver.wait_for_message("sim.npz: belongs to another recording")
    driver.wait(lambda: not says_iou(driver))


@pytest.mark.long
def test_command_line_option_for_ground_truth(qtbot, sensor, files):
    rec, truth = files / "sim.mcap", files / "what_is_true.npz"
    with window_session(Startup(sensor, rec, 2, truth=truth)) as session:
        session.window.show()
        session.window.panels["threshold"].show()
        curve = lambda: session.controller.inspection.kappa_curve  # noqa: E731
        session.wait_for(lambda: curve() is not None and curve().iou is not None, "IoU")
    done = run_bubbleviz("open", rec, "--sensor", files / "dome.toml", "--truth", rec)
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1
    assert "the ground truth cannot be read" in done.stderr
    refused = CliRunner().invoke(main, ["open", "--source", "synthetic:", "--truth", str(truth)])
    assert refused.exit_code == 2 and "--truth" in refused.stderr


def own_camera(sensor, folder):
    """A sensor of another image size, and its file and recording."""
    camera = sensor.camera.model_copy(update={"width": 60, "height": 44, "cx": 29.5, "cy": 21.5})
    own = sensor.model_copy(update={"camera": camera, "name": "own dome"})
    save_sensor(own, folder / "own.toml")
    source = DentSource(own)
    return folder / "own.toml", record(folder / "own.mcap", (source[k] for k in range(4)))


def test_the_solver_thread_hands_a_sensor_of_another_camera_back(
    drive, sensor, tmp_path, monkeypatch
):
    """It counts once its answer was delivered, whatever the solver thread does meanwhile."""
    monkeypatch.setattr("bubbleviz_ui.files.file_to_open", lambda *_, **__: None)
    file, recording = own_camera(sensor, tmp_path)
    opening = drive(DentSource).window.controller.opening
    requests = []
    opening.about_to_open.connect(requests.append)
    opening.open_sensor_file(file)
    with ThreadPoolExecutor(1) as thread:
        error = thread.submit(requests[-1].open_sensor).exception()
    opening.open_recording(recording)  # before the answer
    with pytest.raises(UnknownCameraError):
        requests[-1].open_sensor()
    opening.finish(requests[0], Failed("open", str(error), error=error))
    opening.open_recording(recording)
    assert requests[-1].open_sensor().name == "own dome"
    opening.cancel()


def test_recording_of_an_own_camera_takes_its_sensor_file_in_any_order(
    drive, sensor, tmp_path, monkeypatch
):
    """Sensor first, recording first, and again after a restart."""
    file, recording = own_camera(sensor, tmp_path)
    asked = []

    def choose(parent, title, kinds, *, of, proposed):
        asked.append((title, proposed))
        return proposed

    monkeypatch.setattr("bubbleviz_ui.files.file_to_open", choose)
    driver = drive(DentSource)
    name = lambda: driver.window.controller.sensor.name  # noqa: E731
    driver.drop(file)
    driver.wait_for_message("own.toml", "60×44", "open a recording of, or connect to, a camera")
    assert name() == sensor.name
    driver.drop(recording)
    driver.wait(lambda: name() == "own dome")
    assert not asked
    # another window, which knows neither
    driver = drive(DentSource)
    driver.drop(recording)
    driver.wait(lambda: name() == "own dome")
    assert asked == [("Sensor file for images of 60×44 pixels", file)]


def test_synthetic_press_shows_its_first_frame_before_it_simulates_the_others(sensor, monkeypatch):
    simulated, contact = [], SyntheticSource.contact

    def counted(source, index):
        simulated.append(index)
        return contact(source, index)

    monkeypatch.setattr(SyntheticSource, "contact", counted)
    press = SYNTHETIC.open(sensor)
    assert np.isfinite(press[0].depth_m).any() and set(simulated) == {0}
    first, again = press[70].depth_m, press[70].depth_m
    assert simulated == [0, 70]  # the next loop only differs in noise
    np.testing.assert_allclose(first, again, atol=0.02)
    press.close()
