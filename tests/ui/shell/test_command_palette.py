"""The command palette, by the keyboard alone, and its search."""

from PySide6.QtCore import QPoint, Qt
from PySide6.QtWidgets import QApplication
from window_driver import CTRL, SHIFT

from bubbleviz_ui.shell.command_palette import CommandPalette
from bubbleviz_ui.shell.shortcuts import ranked


def opened(driver, key=Qt.Key.Key_K, held=CTRL):
    driver.key(key, held)
    return driver.window.findChildren(CommandPalette)[-1]


def done(driver, letters):
    """Type letters and press Enter; the name of what was done, with its keys."""
    palette = opened(driver)
    driver.bot.keyClicks(palette.search, letters)
    name = str(palette.list.currentItem().text())
    driver.bot.keyClick(palette.search, Qt.Key.Key_Return)
    QApplication.processEvents()
    assert not driver.window.findChildren(CommandPalette)
    return name


def test_palette_by_keyboard(drive):
    driver = drive(frame=3)
    title, palette = driver.window.windowTitle(), opened(driver)
    found = lambda: [palette.list.item(row).text() for row in range(palette.list.count())]  # noqa: E731
    assert len(found()) > 30
    assert not any("Undo" in name for name in found())  # nothing to undo yet: it is not offered
    for typed, first in {
        "play": "Playback › Play / pause",
        "review": "View › Scene › Review",
        "plots": "View › Plots",
        "import": "File › Import",
        "dark": "View › Theme › Dark",
        "theme dark": "View › Theme › Dark",
        "screen": "View › Full screen",
        "nextm": "Playback › Next marker",
        "analyse": "Playback › Analyse all frames",
    }.items():
        palette.search.setText(typed)
        assert found()[0].split("    ")[0] == first
    palette.search.setText("zzzz")
    assert found() == ["No matching command"]
    driver.bot.keyClick(palette.search, Qt.Key.Key_Return)
    driver.click(palette.list.viewport(), QPoint(40, 8))
    assert palette.isVisible() and driver.state.frame == 3
    palette.search.setText("last frame")
    assert found()[0].startswith("Playback › Last frame")
    driver.bot.keyClick(palette.search, Qt.Key.Key_Escape)
    assert driver.window.windowTitle() == title
    # letters and Enter do it, arrows choose and Escape leaves
    assert done(driver, "lastfr").split() == ["Playback", "›", "Last", "frame", "End"]
    assert driver.state.frame == driver.state.facts.frames - 1
    for shown in (True, False):
        assert done(driver, "wireframe") == "View › Visible layers › Wireframe"
        assert ("wireframe" in driver.state.settings.layers) is shown
        assert driver.window.layers.boxes["wireframe"].isChecked() is shown
    palette = opened(driver)
    driver.bot.keyClicks(palette.search, "theme")
    names = [palette.list.item(row).text() for row in range(3)]
    assert sorted(n.split(" › ")[-1] for n in names) == ["As the system", "Dark", "Light"]
    for _ in range(next(row for row, name in enumerate(names) if "Dark" in name)):
        driver.bot.keyClick(palette.search, Qt.Key.Key_Down)
    driver.bot.keyClick(palette.search, Qt.Key.Key_Return)
    assert driver.state.settings.theme == "dark"
    palette = opened(driver, Qt.Key.Key_P, CTRL | SHIFT)
    driver.bot.keyClicks(palette.search, "quit")
    driver.bot.keyClick(palette.search, Qt.Key.Key_Escape)
    QApplication.processEvents()
    assert driver.window.isVisible() and not driver.window.findChildren(CommandPalette)


def test_search_finds_words_and_their_beginnings():
    names = ["Playback › Play / pause", "Playback › Last frame", "View › Plots", "File › Quit"]
    for typed, found in {
        "pp": names[:1], "pause play": names[:1], "plots": names[2:3],
        "lastfr": names[1:2], "playback": names[:2], "ause": names[:1], "pu": [], "fileplots": [],
    }.items():  # fmt: skip
        assert ranked(typed, names) == found, typed
    poses = ["View › Reset pose", "View › Scene › Pose", "View › Pose"]
    assert ranked("", ["View › Scene › Pose", *names]) == ["View › Scene › Pose", *names]
    assert ranked("Pose", poses) == ["View › Pose", "View › Scene › Pose", "View › Reset pose"]
    layer = "View › Visible layers › Patch contour"
    assert ranked("batch", [layer]) == []
    files = ["File › Open recording…", "File › Open sensor…"]
    assert ranked("open", files) == files
    for typed, others in {"review": "Reset view", "screen": "Screenshot"}.items():
        names = [others, f"Full {typed}"]
        assert ranked(typed, names)[0] == names[1]
