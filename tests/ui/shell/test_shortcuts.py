"""Keys listed, changed, refused and saved."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtWidgets import QTableWidget
from window_driver import Driver

from bubbleviz_ui.shell.shortcuts_dialog import ShortcutsDialog

Drive = Callable[..., Driver]
LEFT = Qt.MouseButton.LeftButton
PLAY, LOOP = "Playback › Play / pause", "Playback › Loop"


def dialog(driver: Driver) -> ShortcutsDialog:
    driver.window.shortcuts.actions["Help › Keyboard shortcuts"].trigger()
    return driver.window.findChildren(ShortcutsDialog)[-1]


def row_of(table: QTableWidget, name: str) -> int:
    return next(r for r in range(table.rowCount()) if table.item(r, 0).text() == name)


def test_all_actions_are_listed_and_no_two_share_keys_as_shipped(drive: Drive) -> None:
    driver = drive()
    shortcuts = driver.window.shortcuts
    keys = Counter(k.toString() for a in shortcuts.actions.values() for k in a.shortcuts())
    assert len(keys) > 30
    assert not [k for k, count in keys.items() if count > 1]
    opened = dialog(driver)
    names = {opened.table.item(r, 0).text() for r in range(opened.table.rowCount())}
    assert {PLAY, "File › Save session as", "View › Theme › Dark", "Edit › Undo"} <= names
    assert opened.table.item(row_of(opened.table, PLAY), 1).text() == "Space"
    opened.close()


def test_other_keys_by_keyboard_and_a_conflict_is_refused(drive: Drive) -> None:
    driver = drive()
    opened = dialog(driver)
    driver.bot.keyClicks(opened.search, "play pause")
    assert opened.name == PLAY
    opened.keys.setFocus()
    driver.bot.keyClick(opened.keys, Qt.Key.Key_L)
    driver.bot.mouseClick(opened.set, LEFT)
    assert "taken by" in opened.problem.text() and LOOP in opened.problem.text()
    assert driver.window.shortcuts.keys(PLAY) == "Space"
    opened.keys.setKeySequence(QKeySequence())
    driver.bot.keyClick(opened.keys, Qt.Key.Key_J)
    driver.bot.mouseClick(opened.set, LEFT)
    assert driver.window.shortcuts.keys(PLAY) == "J" and not opened.problem.text()
    assert opened.table.item(row_of(opened.table, PLAY), 1).text() == "J"
    opened.close()
    with driver.bot.waitActive(driver.window):
        driver.window.activateWindow()
    driver.bot.keyClick(driver.window, Qt.Key.Key_J)
    assert driver.state.playing
    driver.bot.keyClick(driver.window, Qt.Key.Key_Space)
    assert driver.state.playing
    driver.state.set_playing(False)


def test_default_again(drive: Drive) -> None:
    driver = drive()
    shortcuts = driver.window.shortcuts
    assert shortcuts.set_keys(PLAY, QKeySequence("J")) == ""
    assert shortcuts.set_keys(LOOP, QKeySequence("Space")) == ""
    opened = dialog(driver)
    opened.table.selectRow(row_of(opened.table, PLAY))
    driver.bot.mouseClick(opened.reset, LEFT)
    assert LOOP in opened.problem.text()
    driver.bot.mouseClick(opened.reset_all, LEFT)
    assert (shortcuts.keys(PLAY), shortcuts.keys(LOOP)) == ("Space", "L")
    opened.table.selectRow(row_of(opened.table, PLAY))
    driver.bot.mouseClick(opened.clear, LEFT)
    assert shortcuts.keys(PLAY) == ""
    opened.close()


def test_keys_go_with_the_session(drive: Drive) -> None:
    one, other = drive(), drive()
    one.window.shortcuts.set_keys(LOOP, QKeySequence())
    one.window.shortcuts.set_keys(PLAY, QKeySequence("L"))
    saved = one.window.session_saver.snapshot().shortcuts
    assert saved == {PLAY: "L", LOOP: ""}
    other.window.shortcuts.use(saved)
    assert other.window.shortcuts.changed == saved
