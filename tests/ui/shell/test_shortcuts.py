"""Keys listed, changed, refused and saved."""

from collections import Counter

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence

from bubbleviz_ui.shell.shortcuts import ShortcutsDialog

PLAY, LOOP = "Playback › Play / pause", "Playback › Loop"


def test_shortcuts_are_listed_changed_rejected_and_reset(drive):
    driver = drive()
    shortcuts = driver.window.shortcuts
    keys = Counter(k.toString() for a in shortcuts.actions.values() for k in a.shortcuts())
    assert len(keys) > 30 and set(keys.values()) == {1}
    driver.trigger("Help › Keyboard shortcuts")
    dialog = driver.window.findChildren(ShortcutsDialog)[-1]
    table = dialog.table
    listed = {table.item(r, 0).text(): table.item(r, 1) for r in range(table.rowCount())}
    assert {PLAY, "File › Save session as", "View › Theme › Dark", "Edit › Undo"} <= set(listed)
    assert listed[PLAY].text() == "Space"
    driver.bot.keyClicks(dialog.search, "play pause")
    assert dialog.name == PLAY
    dialog.keys.setFocus()
    driver.bot.keyClick(dialog.keys, Qt.Key.Key_L)
    driver.click(dialog.set)
    assert "conflicts" in dialog.problem.text() and LOOP in dialog.problem.text()
    assert shortcuts.keys(PLAY) == "Space"
    dialog.keys.setKeySequence(QKeySequence())
    driver.bot.keyClick(dialog.keys, Qt.Key.Key_J)
    driver.click(dialog.set)
    assert shortcuts.keys(PLAY) == "J" and not dialog.problem.text()
    assert any(table.item(r, 1).text() == "J" for r in range(table.rowCount()))
    dialog.close()
    for key in (Qt.Key.Key_J, Qt.Key.Key_Space):  # the former key does nothing any more
        driver.key(key)
        assert driver.state.playing
    driver.state.set_playing(False)
    # the default is taken by another action, until all have theirs
    assert shortcuts.set_keys(LOOP, QKeySequence("Space")) == ""
    driver.trigger("Help › Keyboard shortcuts")
    dialog = driver.window.findChildren(ShortcutsDialog)[-1]
    driver.bot.keyClicks(dialog.search, "play pause")
    driver.click(dialog.reset)
    assert LOOP in dialog.problem.text()
    driver.click(dialog.reset_all)
    assert (shortcuts.keys(PLAY), shortcuts.keys(LOOP)) == ("Space", "L")
    assert dialog.name == PLAY
    driver.click(dialog.clear)
    assert shortcuts.keys(PLAY) == ""
    dialog.close()
    # they go with the session
    shortcuts.set_keys(LOOP, QKeySequence())
    shortcuts.set_keys(PLAY, QKeySequence("L"))
    saved = driver.window.session_saver.snapshot().shortcuts
    assert saved == {PLAY: "L", LOOP: ""}
    shortcuts.reset_all()
    assert not shortcuts.changed
    shortcuts.use(saved)
    assert shortcuts.changed == saved
