"""A session file of somebody else connects to other computers only after a question."""

import socket

from fakes import small_sensor
from live_bench import sensor_file
from PySide6.QtWidgets import QMessageBox

from bubbleviz_ui.live.connection import single
from bubbleviz_ui.session_files.session_file import SavedSession
from bubbleviz_ui.window_session import Startup, window_session


def test_session_file_connects_to_other_computers_only_after_a_question(
    qtbot, tmp_path, monkeypatch
):
    """The question names address and password file; the default is No."""
    asked, answers = [], [None, QMessageBox.StandardButton.Yes]

    def answer(parent, title, text, buttons, default):
        asked.append(text)
        assert default == QMessageBox.StandardButton.No
        return answers.pop(0) or default

    monkeypatch.setattr(QMessageBox, "question", answer)
    (tmp_path / "login").write_text("ann:secret")
    with socket.socket() as robot:
        robot.bind(("127.0.0.1", 0))
        robot.listen()
        robot.setblocking(False)

        def is_called():
            try:
                robot.accept()[0].close()
            except BlockingIOError:
                return False
            return True

        endpoint = f"tcp/127.0.0.1:{robot.getsockname()[1]}"
        place = f"zenoh:{endpoint}?login={tmp_path / 'login'}"
        saved = SavedSession(live=single(place, sensor_file(tmp_path)))
        (tmp_path / "a.json").write_text(saved.model_dump_json())
        with window_session(Startup(small_sensor())) as session:
            session.wait_for(lambda: not session.state.facts.is_empty, "opening")

            def open_file(times):
                session.window.session_saver.open(tmp_path / "a.json")
                session.wait_for(lambda: asked[times:] or is_called(), "a question or a connection")
                assert len(asked) == times + 1 and place in asked[times]

            open_file(0)
            shown = set[int]()
            session.wait_for(lambda: shown.add(session.state.frame) or len(shown) > 5, "play")
            assert not is_called() and session.window.live_controller.connection is None
            open_file(1)
            session.wait_for(is_called, "a connection")
