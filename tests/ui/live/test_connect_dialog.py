"""Connect dialog: topics, source argument, error messages."""

import pytest
from fakes import DentSource
from live_bench import record_dents, sensor_file
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDialogButtonBox, QFileDialog

from benchmarks.window.live_soak import free_port
from bubbleviz.live import Credentials, SessionOptions, open_session
from bubbleviz.recordings import AUTO
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.live import connect_dialog
from bubbleviz_ui.live.connect_dialog import KINDS, PAIR, REALSENSE, REPLAY, ZENOH, ConnectDialog
from tests.live.streams import robot
from tests.recordings.bagmaker import BagMaker, fill


@pytest.fixture(autouse=True)
def answers_soon():
    """What is typed is looked up at once."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("TYPING_MS", "UPDATE_MS"):
            patch.setattr(connect_dialog, name, 40)
        yield


def opened(bench, sensor=None):
    chosen = sensor or sensor_file(bench.folder)
    dialog = ConnectDialog(bench.window, bench.live_controller, chosen)
    dialog.open()
    return dialog


def choose_kind(dialog, kind):
    dialog.kind.setCurrentIndex(dialog.kind.findData(kind))


def test_dialog_reports_a_rejected_certificate_lists_topics_and_connects_two_sensors(
    open_bench, tls
):
    bench = open_bench()
    place, own = f"tls/localhost:{free_port()}", Credentials(cert=tls.cert, key=tls.key)
    source = f"zenoh:{place}?ca={tls.other}"
    why = "refused: the certificate of localhost is not signed by "
    why += f"ca={tls.other}; give the certificate of its authority as ca= ({source})"
    with open_session(SessionOptions("robot", listen=place, credentials=own)):
        for sensor in (sensor_file(bench.folder), AUTO):
            dialog = opened(bench, sensor)
            says = dialog.problem.text
            for file, text in ((tls.ca, "No topics yet; looking…"), (tls.other, why)):
                dialog.place.setEditText(f"{place}?ca={file}")
                bench.wait(lambda says=says, text=text: says() == text)
            assert dialog.source.text() == source
            assert not dialog.source.hasFrame()  # it cannot be edited
            dialog.buttons.button(QDialogButtonBox.StandardButton.Ok).click()
            bench.wait(lambda: why in bench.window.live.state.text())
            bench.window.live.leave.click()
    # topics are listed when the robot appears
    port = free_port()
    dialog, place = opened(bench), f"tcp/127.0.0.1:{port}"
    dialog.place.setEditText("tcp/robot.invalid:9")
    bench.wait(lambda: "robot.invalid cannot be resolved" in dialog.problem.text())
    dialog.place.setEditText(place)
    bench.wait(lambda: f"nothing listens at 127.0.0.1:{port}" in dialog.problem.text())
    with robot(port):
        bench.wait(lambda: not dialog.problem.text() and dialog.topics.count() > 1)
        offered = [dialog.topics.item(k).text() for k in range(dialog.topics.count())]
        assert any(text.startswith("/cam/depth ") for text in offered)
        assert not any("camera_info" in text or "/gas" in text for text in offered)
        dialog.topics.setCurrentRow(1)
        assert dialog.uri == f"zenoh:{place}?depth=/cam/depth" == dialog.source.text()
        dialog.accept()
        bench.wait_for_frames(3)
    assert bench.run.preset.sensors[0].sensor == sensor_file(bench.folder)
    # a second source connects two sensors
    bench.window.live.leave.click()
    path, file = record_dents(bench.folder / "dents.mcap"), sensor_file(bench.folder)
    dialog = opened(bench, file)
    choose_kind(dialog, REPLAY)
    dialog.place.setEditText(str(path))
    dialog.second.setFocus()
    bench.bot.keyClicks(dialog.second, "nonsense")
    dialog.accept()
    assert dialog.isVisible() and "nonsense" in dialog.problem.text()
    bench.type(dialog.second, f"replay:{path}?loop=true")
    bench.wait(lambda: bench.run is not None)
    bench.wait(lambda: bench.second is not None)
    bench.wait(lambda: bench.second.opened is not None)
    assert [button.text() for button in bench.window.live.sensors] == ["● first", "● second"]
    assert bench.run.preset.sensors[1].sensor == file
    choose_kind(dialog, PAIR)
    assert dialog.second.isHidden()


def test_source_argument_and_sensor_of_each_kind_of_source(open_bench, tmp_path, monkeypatch):
    bench = open_bench()
    bench.window.menus.show_connect()
    dialog = bench.window.findChild(ConnectDialog)
    dialog.kind.setFocus()
    for kind in KINDS:
        expected = "dual_nut" if kind == PAIR else f"{kind}:"
        assert dialog.kind.currentData() == kind and dialog.source.text() == expected
        bench.bot.keyClick(dialog.kind, Qt.Key.Key_Down)
    choose_kind(dialog, REALSENSE)
    bench.wait(lambda: "realsense" in dialog.problem.text().lower())
    choose_kind(dialog, REPLAY)
    dialog.place.setEditText("nowhere.mcap")
    bench.wait(lambda: "nowhere.mcap" in dialog.problem.text())
    # a rosbag2 folder
    folder = fill(BagMaker("sqlite")).write(tmp_path)
    assert folder.is_dir()
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_, **__: str(folder))
    bench.click(dialog.folder)
    assert dialog.source.text() == f"replay:{folder}"
    bench.wait(lambda: dialog.topics.count() > 1)
    choose_kind(dialog, ZENOH)
    assert not dialog.folder.isVisible()
    dialog.reject()
    assert bench.live_controller.connection is None
    # with a sensor file or a matching preset
    path, file = record_dents(bench.folder / "dents.mcap"), sensor_file(bench.folder)
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (file, ""))
    monkeypatch.setattr("bubbleviz.recordings.sensor_matching.preset_names", lambda _: [file])
    dialog = ConnectDialog(bench.window, bench.live_controller, None)
    choose_kind(dialog, REPLAY)
    dialog.place.setEditText(str(path))
    dialog.sensor.setCurrentIndex(dialog.sensor.findText("pico_flexx_75mm"))
    dialog.accept()
    bench.wait(bench.window.message.isVisible)
    assert bench.message_text.endswith(
        "images are 64×48 pixels but the camera of sensor pico_flexx_75mm.toml has 224×171; choose "
        "the sensor file of this camera"
    )
    assert bench.live_controller.run is None and bench.live_controller.connection is None
    dialog.browse_sensor.click()
    assert dialog.sensor.currentText() == file
    dialog.sensor.setCurrentIndex(dialog.sensor.findText("automatic", Qt.MatchFlag.MatchStartsWith))
    dialog.accept()
    bench.wait(lambda: bench.live_controller.run is not None)
    assert bench.run.preset.sensors[0].sensor == file
    # the sensor of a simulation is not proposed for a camera
    bench.window.live.leave.click()
    bench.show_source(DentSource, load_sensor(file))

    def proposed():
        bench.trigger("Live › Connect")
        dialog = bench.window.findChildren(ConnectDialog)[-1]
        dialog.reject()
        return dialog.sensor.currentData()

    assert proposed() == file
    bench.open("built-in press", DentSource, load_sensor(file), live=True)
    bench.wait(lambda: bench.state.facts.simulated)
    assert proposed() == AUTO
