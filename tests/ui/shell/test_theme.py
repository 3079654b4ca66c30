"""Dark and light: chosen in the menu, read back from pixels; and no text that does not fit."""

import re
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QApplication, QLineEdit
from window_driver import CONTACT, clipped_texts, painted

from bubbleviz_ui.live.live_bar import BADGES
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import rgb

HERE = Path(__file__).parents[1]


def contrast(one, other):
    """Contrast ratio as WCAG 2 defines it, 1 … 21."""

    def luminance(colour):
        parts = [colour.redF(), colour.greenF(), colour.blueF()]
        r, g, b = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
        return 0.2126 * r + 0.7152 * g + 0.0722 * b

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_theme_menu_changes_all_parts_with_enough_contrast(drive):
    driver = drive(frame=CONTACT)
    window = driver.window
    parts = (window.status, window.menuBar(), window.layers, window.kappa, window.playback)
    for title, colours in (("Light", theme.LIGHT), ("Dark", theme.DARK)):
        driver.trigger(f"View › Theme › {title}")
        driver.wait_until_shown()
        corner = driver.pixels()[-3, 3]
        assert np.allclose(corner, rgb(colours.view), atol=2)
        is_light = colours is theme.LIGHT
        for part in parts:
            assert (np.median(painted(part)) > 127) == is_light, part
        # Text of the readout, at the upper left of the view.
        head = driver.pixels()[:50, :160].reshape(-1, 3).astype(int)
        assert np.abs(head - rgb(colours.text)).sum(axis=1).min() < 12
        # The icon on the play button.
        play = painted(window.playback.buttons["Play / pause"]).reshape(-1, 3).astype(int)
        assert np.abs(play - rgb(colours.text)).sum(axis=1).min() < 12
        assert len(driver.pressure_pixels()) > 200  # pressure has its colours on both
    driver.trigger("View › Theme › As the system")
    changed = QApplication.styleHints().colorSchemeChanged  # a desktop emits it; Xvfb is none
    changed.emit(Qt.ColorScheme.Light)
    assert theme.of(driver.window) is theme.LIGHT
    changed.emit(Qt.ColorScheme.Dark)
    assert theme.of(driver.window) is theme.DARK
    driver.trigger("View › Theme › Light")
    changed.emit(Qt.ColorScheme.Dark)
    assert theme.of(driver.window) is theme.LIGHT  # what was chosen outlives the system's
    # checked buttons stand out, also in panels shown later
    loop, playback = driver.window.playback.buttons["Loop"], driver.window.panels["playback"]
    for title in ("Light", "Dark"):
        playback.hide()
        driver.trigger(f"View › Theme › {title}")
        playback.show()
        driver.wait_for_redraw()
        grounds = {}
        for _ in range(2):
            driver.click(loop)
            grounds[loop.isChecked()] = QColor(*map(int, np.median(painted(loop), axis=(0, 1))))
        assert (grounds[False].lightness() > 127) == (title == "Light")
        assert contrast(grounds[True], grounds[False]) > 3.0, title
    # so do marks, and selected and disabled text
    for title in ("Dark", "Light"):
        driver.trigger(f"View › Theme › {title}")
        check_contrasts(driver)


@pytest.mark.parametrize("colours", [theme.DARK, theme.LIGHT], ids=["dark", "light"])
def test_text_contrast(colours):
    for ground in (colours.window, colours.field, colours.view):
        assert contrast(QColor(colours.text), QColor(ground)) > 7.0
        assert contrast(QColor(colours.dim), QColor(ground)) > 4.5
    for grade in (colours.good, colours.usable, colours.doubtful):
        assert contrast(QColor(grade), QColor(colours.window)) > 4.0
    for badge in BADGES.values():
        assert contrast(QColor(theme.ON_BADGE), QColor(badge)) > 4.5
    assert contrast(QColor(colours.on_accent), QColor(colours.accent)) > 4.5
    roles = QPalette.ColorRole
    for ground in (colours.window, colours.field):
        for link in (roles.Link, roles.LinkVisited):
            assert contrast(theme.palette(colours).color(link), QColor(ground)) > 4.5


def selected(item):
    """Contrast between the ground of what is selected and its text, the pixel furthest from it."""
    flat = item.reshape(-1, 3)
    found, counts = np.unique(flat, axis=0, return_counts=True)
    ground = found[counts.argmax()].astype(int)
    text = flat[np.abs(flat - ground).sum(axis=1).argmax()]
    return contrast(QColor(*map(int, ground)), QColor(*map(int, text)))


def within(widget, place):
    """Pixels of a part of a widget, its frame and check mark aside."""
    left, top = place.left() + 28, place.top() + 3
    return painted(widget)[top : place.bottom() - 2, left : place.right() - 28]


def check_contrasts(driver):
    # unchecked boxes and separators of menus
    menu = driver.menu("View")
    menu.popup(driver.window.pos())
    box = next(a for a in menu.actions() if a.isCheckable() and not a.isChecked())
    line = next(a for a in menu.actions() if a.isSeparator())
    for action in (box, line):
        place = menu.actionGeometry(action)
        part = painted(menu)[place.top() : place.bottom() + 1, place.left() + 4 : 28]
        assert selected(part) > 3.0, action.text()  # WCAG 2, parts of controls
    menu.close()
    menu = driver.menu("File")
    menu.popup(driver.window.pos())
    action = menu.actions()[0]
    menu.setActiveAction(action)
    assert selected(within(menu, menu.actionGeometry(action))) > 4.5
    menu.close()
    box = driver.window.playback.speed
    box.showPopup()
    view = box.view()
    driver.wait(view.isVisible)
    place = view.visualRect(view.currentIndex())
    assert selected(within(view.viewport(), place.adjusted(-22, 0, 22, 0))) > 4.5
    box.hidePopup()
    number = driver.window.layers.pressure_max
    number.selectAll()
    line = number.findChild(QLineEdit)
    assert line is not None and selected(painted(line)[4:-4, 2:30]) > 4.5
    # what is disabled, in controls of every kind and in a menu, can be read and looks it
    driver.show("pose")
    QApplication.processEvents()
    pose, menu = driver.window.pose, driver.menu("View", "Theme")
    for widget in (pose.search, pose.unit, pose.once, pose.track, pose.start):
        now = []
        for enabled in (True, False):
            widget.setEnabled(enabled)
            now.append(selected(painted(widget)[4:-4, 24:70]))
        assert now[0] > 1.5 * now[1] > 1.5 * 3.0, (widget, now)
    action = menu.actions()[0]
    menu.popup(driver.window.pos())
    place = menu.actionGeometry(action)
    before = selected(within(menu, place))
    action.setEnabled(False)
    assert before > 1.5 * selected(within(menu, place)) > 1.5 * 3.0
    menu.close()
    action.setEnabled(True)


def test_colours_are_defined_only_in_the_theme():
    for path in (HERE.parents[1] / "ui").rglob("*.py"):
        if path.name != "theme.py":
            found = re.findall(r"[\"'>:]#[0-9a-fA-F]{3,8}\b", path.read_text(encoding="utf-8"))
            assert not found, (path, found)


def test_the_window_fits_into_1280_by_800(drive):
    driver = drive(frame=CONTACT, live=True)
    for name in ("dark", "light"):
        driver.state.change(theme=name)
        driver.window.resize(1280, 800)
        driver.window.show_rates()
        driver.wait_until_shown()
        assert driver.size == (1280, 800)
        for panel in driver.window.panels.values():
            shown = panel.isVisible()
            panel.show()
            QApplication.processEvents()
            assert driver.size == (1280, 800), (name, panel)
            assert not clipped_texts(panel)
            panel.setVisible(shown)
        assert not clipped_texts(driver.window)
