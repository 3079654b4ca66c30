"""What went well is told quietly, what went wrong until it was read; waiting has a way out."""

from pathlib import Path
from threading import Event

import pytest
from fakes import DentSource
from PySide6.QtCore import QObject, QUrl, Slot
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QApplication, QWidget
from window_driver import clipboard_text

from bubbleviz_ui.model.messages import Messages
from bubbleviz_ui.session_files.session_file import read_user_file
from bubbleviz_ui.shell import message_bars
from bubbleviz_ui.shell.text_dialogs import MessagesDialog


class Desktop(QObject):
    """Opens files in place of the desktop."""

    def __init__(self):
        super().__init__()
        self.opened: list[Path] = []

    @Slot(QUrl)
    def open(self, url):
        self.opened.append(Path(url.toLocalFile()))


@pytest.fixture
def desktop():
    made = Desktop()
    QDesktopServices.setUrlHandler("file", made, "open")
    yield made
    QDesktopServices.unsetUrlHandler("file")


def test_notice_messages_and_hint_by_clicks(drive, desktop, tmp_path, monkeypatch):
    driver = drive(frame=5)
    window, notice, path = driver.window, driver.window.notice, tmp_path / "shot.png"
    window.save_screenshot(path)
    assert notice.isVisible() and notice.label.text() == "Saved shot.png"
    assert str(path) in notice.label.toolTip()
    assert not window.message.isVisible()
    driver.click(notice.open)
    driver.click(notice.folder)
    assert desktop.opened == [path, tmp_path]
    path.unlink()
    driver.click(notice.open)
    assert f"{path}: no longer exists" in driver.message_text
    driver.click(notice.dismiss)
    assert not notice.isVisible()
    # a session is opened in the window
    window.session_saver.save_as(tmp_path / "look.bubbleviz")
    driver.state.change(kappa=2.5)
    driver.click(notice.open)
    assert driver.state.settings.kappa is None
    # a notice moves nothing: it is beside the menus, the end of a long name left out
    driver.click(window.message.dismiss)
    driver.click(notice.dismiss)
    bar = window.menuBar()
    QApplication.processEvents()
    before = window.view.geometry()
    path = tmp_path / ("long_" * 40 + ".png")
    window.messages.add("notice", f"Saved {path}", file=path)
    driver.wait(notice.isVisible)
    QApplication.processEvents()
    assert window.view.geometry() == before
    menus = [bar.actionGeometry(action) for action in bar.actions()]
    assert notice.x() > max(menu.right() for menu in menus)
    assert bar.rect().contains(notice.geometry())
    assert notice.rect().contains(notice.dismiss.geometry()) and str(path) in notice.label.toolTip()
    driver.click(notice.dismiss)
    assert not notice.isVisible()
    # the tip of a long warning has all of it
    warning = "the sensor file does not fit the depth without contact. " * 4
    window.messages.add("warning", warning)
    assert warning in window.message.label.toolTip()
    driver.click(window.message.dismiss)
    # it leaves by itself, and what went wrong stays
    monkeypatch.setattr(message_bars, "NOTICE_MS", 500)
    window.save_screenshot(tmp_path / "missing" / "shot.png")
    window.session_saver.save_as(tmp_path / "look.bubbleviz")  # something else
    assert window.notice.isVisible()
    driver.wait(lambda: not window.notice.isVisible())
    driver.wait_for_message("missing does not exist; create it")
    driver.click(window.message.dismiss)
    assert not window.message.isVisible()
    monkeypatch.undo()
    # messages are shown by kind, listed and copied
    message = window.message
    for theme in ("dark", "light"):
        driver.state.change(theme=theme)
        seen = set()
        for kind in ("warning", "error", "notice"):
            window.messages.add(kind, "text")
            bar = window.notice if kind == "notice" else message
            driver.wait(bar.isVisible)
            seen.add(bar.grab().toImage().pixelColor(3, 3).name())
        assert len(seen) == 3
        for _ in range(2):
            driver.click(message.dismiss)
    before = len(window.messages.all)
    window.messages.add("error", "bad", "Traceback: here")
    for _ in range(2):
        window.messages.add("warning", "odd")
    assert message.kind.text() == "Error" and driver.message_text == "bad"
    driver.click(message.more)
    (dialog,) = window.findChildren(MessagesDialog)
    lines = [line.split()[1:] for line in dialog.text.toPlainText().splitlines()]
    told = [line for line in lines[before:] if line[:1] in (["error"], ["warning"])]
    assert told == [["error", "bad"], *[["warning", "odd"]] * 2]
    window.messages.add("notice", "good")
    assert "good" in dialog.text.toPlainText()
    driver.click(dialog.copy)
    places = [clipboard_text().index(text) for text in ("Traceback: here", "odd", "good")]
    assert places == sorted(places)
    dialog.close()
    driver.click(message.dismiss)
    assert message.kind.text() == "Warning" and driver.message_text == "odd"
    driver.click(message.dismiss)
    assert not message.isVisible()
    # the hint is shown until it is read
    saver, hint, file = window.session_saver, window.hint, tmp_path / "session.json"
    assert not hint.isVisible()
    saver.keep_in(file)
    assert hint.isVisible() and "Ctrl+K" in hint.label.text()
    saver.save()
    assert not read_user_file(file).hinted
    driver.click(hint.understood)
    assert not hint.isVisible()
    saver.save()
    assert read_user_file(file).hinted
    saver.keep_in(file)
    assert not hint.isVisible()
    driver.trigger("Help › First steps")
    assert hint.isVisible()


def test_a_count_that_grows_moves_neither_the_list_nor_its_selection(qtbot):
    owner = QWidget()
    qtbot.addWidget(owner)
    messages = Messages(owner)
    shown = messages.revise({}, {"depth": "1 frame contradicts"}, "")
    for number in range(60):
        messages.add("notice", f"Saved {number}.csv")
    dialog = MessagesDialog(owner, messages)
    dialog.show()
    text, bar = dialog.text, dialog.text.verticalScrollBar()
    assert text.find("Saved 20.csv")
    bar.setValue(15)
    for count in ("11 frames contradict", "112 frames contradict"):
        shown = messages.revise(shown, {"depth": count}, "")
    assert "warning\t112 frames contradict\n" in text.toPlainText()
    assert "1 frame c" not in text.toPlainText()
    assert (bar.value(), text.textCursor().selectedText()) == (15, "Saved 20.csv")
    messages.revise(shown, {}, "")  # it does not hold any more, but did
    assert "112 frames contradict" in text.toPlainText()


class SlowOpener:
    """Opens when it is let."""

    def __init__(self):
        self.go, self.begun = Event(), Event()
        self.source: DentSource | None = None

    def __call__(self, sensor):
        self.begun.set()
        assert self.go.wait(20)
        self.source = DentSource(sensor)
        return self.source

    def let_go(self):
        """Whether it was closed after it opened for nothing."""
        return self.source is not None and self.source.closed


def test_slow_opening_shows_progress_and_can_be_cancelled_or_replaced(drive, sensor):
    driver = drive(frame=5)
    window, title = driver.window, driver.window.windowTitle()
    left, replaced, last = SlowOpener(), SlowOpener(), SlowOpener()
    driver.open("slow.mcap", left, sensor)
    driver.wait(window.busy.isVisible)
    assert "slow.mcap" in window.busy.label.text()
    driver.state.seek(6)
    driver.click(window.busy.cancel)
    assert not window.busy.isVisible()
    driver.wait(left.begun.is_set)
    left.go.set()
    driver.wait(left.let_go)
    driver.wait_until_shown()
    assert window.windowTitle() == title and driver.state.frame == 6
    assert not window.message.isVisible()

    driver.open("slow.mcap", replaced, sensor)
    driver.wait(replaced.begun.is_set)
    driver.open("dent", DentSource, sensor, frame=3, playing=False)
    replaced.go.set()
    driver.wait(lambda: driver.state.facts.title == "dent" and driver.state.frame == 3)
    assert replaced.let_go() and not window.busy.isVisible()

    driver.open("slow.mcap", last, sensor, frame=4, playing=False)
    driver.wait(window.busy.isVisible)
    last.go.set()
    driver.wait(lambda: driver.state.frame == 4)
    assert not window.busy.isVisible() and not last.let_go()
