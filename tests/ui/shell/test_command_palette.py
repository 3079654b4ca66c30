"""The command palette, by the keyboard alone, and its search."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtWidgets import QApplication
from window_driver import Driver

from bubbleviz_ui.shell.command_palette import CommandPalette
from bubbleviz_ui.shell.fuzzy_search import ranked, score

Drive = Callable[..., Driver]
CTRL, SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier


def palette(driver: Driver, key: Qt.Key, modifiers: Qt.KeyboardModifier) -> CommandPalette:
    with driver.bot.waitActive(driver.window):
        driver.window.activateWindow()
    driver.bot.keyClick(driver.window, key, modifiers)
    return driver.window.findChildren(CommandPalette)[-1]


def test_letters_and_enter_do_it(drive: Drive) -> None:
    driver = drive(frame=3)
    for key, modifiers in ((Qt.Key.Key_K, CTRL), (Qt.Key.Key_P, CTRL | SHIFT)):
        driver.state.seek(3)
        opened = palette(driver, key, modifiers)
        assert opened.list.count() > 30
        driver.bot.keyClicks(opened.search, "lastfr")
        assert opened.list.currentItem().text().startswith("Playback › Last frame")
        assert "End" in opened.list.currentItem().text()
        driver.bot.keyClick(opened.search, Qt.Key.Key_Return)
        assert driver.state.frame == driver.state.facts.frames - 1
        QApplication.processEvents()
        assert not driver.window.findChildren(CommandPalette)


def test_arrows_choose_and_escape_leaves(drive: Drive) -> None:
    driver = drive(frame=3)
    opened = palette(driver, Qt.Key.Key_K, CTRL)
    driver.bot.keyClicks(opened.search, "theme")
    names = [opened.list.item(row).text() for row in range(3)]
    assert sorted(n.split(" › ")[-1] for n in names) == ["As the system", "Dark", "Light"]
    down = next(row for row, name in enumerate(names) if "Dark" in name)
    for _ in range(down):
        driver.bot.keyClick(opened.search, Qt.Key.Key_Down)
    driver.bot.keyClick(opened.search, Qt.Key.Key_Return)
    assert driver.state.choices.theme == "dark"
    opened = palette(driver, Qt.Key.Key_K, CTRL)
    driver.bot.keyClicks(opened.search, "quit")
    driver.bot.keyClick(opened.search, Qt.Key.Key_Escape)
    QApplication.processEvents()
    assert driver.window.isVisible() and not driver.window.findChildren(CommandPalette)


def test_layers_are_shown_and_hidden(drive: Drive) -> None:
    driver = drive(frame=3)
    for shown in (True, False):
        opened = palette(driver, Qt.Key.Key_K, CTRL)
        driver.bot.keyClicks(opened.search, "wireframe")
        assert opened.list.currentItem().text() == "View › Visible layers › Wireframe"
        driver.bot.keyClick(opened.search, Qt.Key.Key_Return)
        assert ("wireframe" in driver.state.choices.layers) is shown
        assert driver.window.layers.boxes["wireframe"].isChecked() is shown
        QApplication.processEvents()


def test_own_words_come_before_the_path(drive: Drive) -> None:
    opened = palette(drive(frame=3), Qt.Key.Key_K, CTRL)
    names = [opened.list.item(row).text() for row in range(opened.list.count())]
    assert not any("Undo" in name for name in names)  # nothing to undo yet: it is not offered
    for typed, first in {
        "play": "Playback › Play / pause",
        "review": "View › Scene › Review",
        "plots": "View › Plots",
        "import": "File › Import",
        "dark": "View › Theme › Dark",
        "theme dark": "View › Theme › Dark",
        "screen": "View › Full screen",
        "nextm": "Playback › Next marker",
    }.items():
        opened.search.setText(typed)
        assert opened.list.item(0).text().split("    ")[0] == first
    opened.close()


def test_what_fits_nothing_is_said_in_words_and_does_nothing(drive: Drive) -> None:
    driver = drive(frame=3)
    title = driver.window.windowTitle()
    opened = palette(driver, Qt.Key.Key_K, CTRL)
    driver.bot.keyClicks(opened.search, "zzzz")
    assert [opened.list.item(row).text() for row in range(opened.list.count())] == [
        "Nothing fits; type other letters, or fewer"
    ]
    driver.bot.keyClick(opened.search, Qt.Key.Key_Return)
    driver.bot.mouseClick(opened.list.viewport(), Qt.MouseButton.LeftButton, pos=QPoint(40, 8))
    assert opened.isVisible() and driver.state.frame == 3
    driver.bot.keyClick(opened.search, Qt.Key.Key_Backspace)
    opened.search.setText("last frame")
    assert opened.list.item(0).text().startswith("Playback › Last frame")
    driver.bot.keyClick(opened.search, Qt.Key.Key_Escape)
    assert driver.window.windowTitle() == title


def test_search() -> None:
    names = ["Playback › Play / pause", "Playback › Last frame", "View › Plots", "File › Quit"]
    assert ranked("pp", names)[0] == "Playback › Play / pause"
    assert ranked("plots", names) == ["View › Plots"]
    assert ranked("", names) == names
    assert score("xyz", "Playback") is None
    assert score("quit", "File › Quit") > score("quit", "Square unit")  # type: ignore[operator]


def test_search_finds_the_best_place_of_many() -> None:
    """Against all ways to place the letters, tried one by one."""
    from itertools import combinations, pairwise

    def brute(query: str, text: str) -> float | None:
        best = None
        for places in combinations(range(len(text)), len(query)):
            if all(text[p] == letter for p, letter in zip(places, query, strict=True)):
                value = sum(1.0 + 3.0 * (p == 0 or not text[p - 1].isalnum()) for p in places)
                for left, right in pairwise(places):
                    value += 2.0 if right == left + 1 else -0.05 * (right - left - 1)
                best = value if best is None else max(best, value)
        return None if best is None else best - 0.05 * len(text)

    for query in ("ab", "aba", "abab", "c", "cb"):
        for text in ("a bab abc", "abab", "b a ba", "cab b", "aa bb aab"):
            expected = brute(query, text)
            got = score(query, text)
            assert (got is None) == (expected is None)
            if got is not None and expected is not None:
                assert got == pytest.approx(expected, abs=1e-9)
