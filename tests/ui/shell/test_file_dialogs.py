"""Files by the dialogs, typed as a person would: nothing is replaced unasked."""

from fakes import DentSource, record
from PySide6.QtCore import QSettings, Qt
from PySide6.QtGui import QImage
from PySide6.QtWidgets import QApplication, QFileDialog
from window_driver import CTRL, SHIFT, answer_file_dialog

from bubbleviz.files import SESSION_SUFFIX
from bubbleviz_ui.model.settings import Settings


def test_dialogs_ask_before_replacing_add_suffixes_remember_folders_and_leave_space_to_play(
    drive, sensor, tmp_path, monkeypatch
):
    QSettings("bubbleviz", "folders").clear()  # as of a new user
    driver, precious = drive(), tmp_path / f"look{SESSION_SUFFIX}"
    actions = driver.window.shortcuts.actions
    precious.write_text("precious")
    save = actions["File › Save session as"].trigger
    assert answer_file_dialog(driver, save, str(tmp_path / "look")) == ["dialog", "question"]
    assert precious.read_text() == "precious"
    by_keys = lambda: driver.key(Qt.Key.Key_S, CTRL | SHIFT)  # noqa: E731
    assert answer_file_dialog(driver, by_keys, str(tmp_path / "other")) == ["dialog"]
    assert (tmp_path / f"other{SESSION_SUFFIX}").is_file()
    for name in ("shot", "shot.v2"):
        before = set(tmp_path.iterdir())
        answer_file_dialog(driver, actions["File › Screenshot"].trigger, str(tmp_path / name))
        (path,) = set(tmp_path.iterdir()) - before
        assert path.name in ("shot.png", "shot.v2")
        assert path.read_bytes().startswith(b"\x89PNG") and not QImage(str(path)).isNull()
        assert str(path) in driver.window.notice.label.toolTip()
        assert not driver.window.message.isVisible()
    # a dialog comes back to the last folder of its kind
    asked: list[tuple[str, str]] = []
    answers = {"Open recording": "records/a.mcap", "Open sensor": "sensors/b.toml"}

    def chosen(_, title, folder, *__):
        asked.append((title, folder))
        return str(tmp_path / answers[title]), ""

    def several(*asked_for):
        name, kind = chosen(*asked_for)
        return [name], kind

    monkeypatch.setattr(QFileDialog, "getOpenFileName", chosen)
    monkeypatch.setattr(QFileDialog, "getOpenFileNames", several)
    for name in answers.values():
        (tmp_path / name).parent.mkdir()
    for _ in range(2):
        for title in answers:
            driver.trigger(f"File › {title}")
    records = str((tmp_path / answers["Open recording"]).parent)
    assert asked[1] == ("Open sensor", records)  # else to that of the last file
    assert asked[2:] == [(title, str((tmp_path / name).parent)) for title, name in answers.items()]
    driver.wait_for_message()  # neither is there
    (tmp_path / "records").rmdir()
    driver.trigger("File › Open recording")
    assert asked[-1] == ("Open recording", "")
    driver.drop(record(tmp_path / "press.mcap", DentSource(sensor)))
    driver.wait(lambda: driver.state.facts.title == "press.mcap")
    driver.trigger("File › Open recording")
    assert asked[-1] == ("Open recording", str(tmp_path))
    # Space plays after opening by the dialog
    monkeypatch.undo()

    def asked(parent, title, folder, kinds):
        dialog = QFileDialog(parent, title, folder, kinds)
        chosen = dialog.selectedFiles() if dialog.exec() else []
        dialog.deleteLater()
        return chosen, ""

    # Qt's own dialog lives on its stack, where Python must not hold it
    monkeypatch.setattr(QFileDialog, "getOpenFileNames", asked)
    path = record(tmp_path / "again.mcap", DentSource(sensor))
    loop, state = driver.window.playback.buttons["Loop"], driver.state
    driver.activate()
    loop.setFocus()  # as by Tab; Space there is a click on it
    answer_file_dialog(driver, lambda: driver.trigger("File › Open recording"), str(path))
    driver.wait(lambda: state.facts.title == "again.mcap")
    driver.activate()
    driver.wait(lambda: QApplication.focusWidget() is not None)
    state.set_playing(False)
    driver.bot.keyClick(QApplication.focusWidget(), Qt.Key.Key_Space)
    assert state.playing and loop.isChecked() == state.settings.loop == Settings().loop
    state.set_playing(False)
    loop.setFocus()
    driver.choose(solver="fast")  # the same source, solved anew: who is at a box stays there
    assert QApplication.focusWidget() is loop
