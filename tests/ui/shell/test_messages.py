"""What went well is told quietly, what went wrong until it was read, and all of it once more."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QObject, Qt, QUrl, Slot
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QApplication
from window_driver import Driver

from bubbleviz_ui.model.messages import UserMessage
from bubbleviz_ui.shell import message_bars
from bubbleviz_ui.shell.text_dialogs import MessagesDialog

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton


class Desktop(QObject):
    """Opens files in place of the desktop."""

    def __init__(self) -> None:
        super().__init__()
        self.opened: list[Path] = []

    @Slot(QUrl)
    def open(self, url: QUrl) -> None:
        self.opened.append(Path(url.toLocalFile()))


@pytest.fixture
def desktop() -> Iterator[Desktop]:
    made = Desktop()
    QDesktopServices.setUrlHandler("file", made, "open")
    yield made
    QDesktopServices.unsetUrlHandler("file")


def test_a_file_that_was_written_is_opened_from_its_notice(
    drive: Drive, desktop: Desktop, tmp_path: Path
) -> None:
    driver = drive()
    window, path = driver.window, tmp_path / "shot.png"
    window.save_screenshot(path)
    notice = window.notice
    assert notice.isVisible() and str(path) in notice.label.text()
    assert not window.message.isVisible()
    driver.bot.mouseClick(notice.open, LEFT)
    driver.bot.mouseClick(notice.folder, LEFT)
    assert desktop.opened == [path, tmp_path]
    path.unlink()
    driver.bot.mouseClick(notice.open, LEFT)
    assert f"{path}: cannot be opened; it is gone" in window.message.label.text()
    driver.bot.mouseClick(notice.dismiss, LEFT)
    assert not notice.isVisible()


def test_a_session_that_was_saved_is_opened_in_the_window(drive: Drive, tmp_path: Path) -> None:
    driver = drive(frame=5)
    window = driver.window
    window.session_saver.save_as(tmp_path / "look.bubbleviz")
    driver.state.choose(kappa=2.5)
    driver.bot.mouseClick(window.notice.open, LEFT)
    assert driver.state.choices.kappa is None


def test_a_notice_leaves_by_itself_and_what_went_wrong_stays(
    drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_bars, "NOTICE_MS", 500)
    driver = drive()
    window = driver.window
    window.save_screenshot(tmp_path / "missing" / "shot.png")
    window.session_saver.save_as(tmp_path / "look.bubbleviz")  # something else
    assert window.notice.isVisible()
    driver.wait(lambda: not window.notice.isVisible())
    assert window.message.isVisible() and "cannot be written" in window.message.label.text()
    driver.bot.mouseClick(window.message.dismiss, LEFT)
    assert not window.message.isVisible()


def test_an_error_is_not_covered_by_a_warning(drive: Drive) -> None:
    driver = drive()
    window, message = driver.window, driver.window.message
    for kind, text in (("error", "bad"), ("warning", "odd"), ("warning", "odd")):
        window.messages.tell(UserMessage(kind, text))
    assert message.kind.text() == "Error" and message.label.text() == "bad"
    driver.bot.mouseClick(message.more, LEFT)
    (dialog,) = window.findChildren(MessagesDialog)
    lines = [line.split(None, 1)[1] for line in dialog.text.toPlainText().splitlines()]
    assert [line.split() for line in lines] == [["error", "bad"], *[["warning", "odd"]] * 2]
    window.messages.tell(UserMessage("notice", "good"))
    assert "good" in dialog.text.toPlainText()
    dialog.close()
    driver.bot.mouseClick(message.dismiss, LEFT)
    assert message.kind.text() == "Warning" and message.label.text() == "odd"
    driver.bot.mouseClick(message.dismiss, LEFT)
    assert not message.isVisible()


def test_all_messages_are_copied_with_their_details(drive: Drive) -> None:
    driver = drive()
    window = driver.window
    window.messages.tell(UserMessage("notice", "Saved it"))
    window.messages.tell(UserMessage("error", "a bug", "Traceback: here"))
    window.messages.tell(UserMessage("warning", "odd"))
    window.shortcuts.actions["Help › Messages"].trigger()
    (dialog,) = window.findChildren(MessagesDialog)
    driver.bot.mouseClick(dialog.copy, LEFT)
    copied = QApplication.clipboard().text()
    assert copied.index("Saved it") < copied.index("Traceback: here") < copied.index("odd")
    dialog.close()


def test_errors_warnings_and_notices_look_different(drive: Drive) -> None:
    driver = drive()
    window = driver.window
    for theme in ("dark", "light"):
        driver.state.choose(theme=theme)
        seen = set()
        for kind in ("warning", "error", "notice"):
            window.messages.tell(UserMessage(kind, "text"))
            bar = window.notice if kind == "notice" else window.message
            driver.wait(bar.isVisible)
            seen.add(bar.grab().toImage().pixelColor(3, 3).name())
        assert len(seen) == 3
        for _ in range(2):
            driver.bot.mouseClick(window.message.dismiss, LEFT)
    assert window.message.kind.text()


def test_a_notice_moves_nothing(drive: Drive, tmp_path: Path) -> None:
    """It is beside the menus, and the middle of a long path is left out."""
    driver = drive()
    window = driver.window
    window.resize(1024, 700)
    before = window.view.geometry()
    path = tmp_path / ("long_" * 40 + ".png")
    window.messages.tell(UserMessage("notice", f"Saved {path}", file=path))
    driver.wait(window.notice.isVisible)
    QApplication.processEvents()
    assert window.view.geometry() == before
    bar, notice = window.menuBar(), window.notice
    menus = [bar.actionGeometry(action) for action in bar.actions()]
    assert notice.x() > max(menu.right() for menu in menus) and bar.rect().contains(
        notice.geometry()
    )
    assert notice.rect().contains(notice.dismiss.geometry()) and str(path) in notice.label.toolTip()
    driver.bot.mouseClick(notice.dismiss, LEFT)
    assert not notice.isVisible()
