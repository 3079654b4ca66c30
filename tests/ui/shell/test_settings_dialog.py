"""The settings page: every setting acts at once, is found by its words, and can be undone."""

from fakes import DentSource
from PySide6.QtCore import Qt

from bubbleviz_ui.shell.settings_dialog import SettingsDialog


def test_settings_act_at_once_are_found_by_words_and_undone(drive, sensor):
    driver = drive(lambda _: DentSource(sensor), frame=11)
    window, state = driver.window, driver.state
    driver.trigger("Edit › Settings")
    (dialog,) = window.findChildren(SettingsDialog)
    controls = dialog.controls
    assert "Pa" in window.status.labels["gas"].text() and controls["pressure_unit"].isVisible()
    # by the words of the label, of the explanation, or of a value
    for words, found in (
        ("pounds per", set()),
        ("psi", {"pressure_unit"}),
        ("skip frames", {"every_frame"}),
        ("threshold", set()),
        ("viridis", {"colour_map"}),
    ):
        dialog.search.clear()
        driver.bot.keyClicks(dialog.search, words)
        assert {name for name, box in controls.items() if box.isVisible()} == found
    dialog.search.clear()
    assert all(box.isVisible() for box in controls.values())
    driver.pick(controls["pressure_unit"], "psi")
    driver.wait(lambda: "psi" in window.status.labels["gas"].text())
    driver.pick(controls["theme"], "Light")
    driver.bot.keyClick(controls["loop"], Qt.Key.Key_Space)
    assert (state.settings.theme, state.settings.loop) == ("light", False)
    # a number is in the unit shown
    driver.type(controls["pressure_max_pa"], "2")
    assert abs(state.settings.pressure_max_pa - 2 * 6_894.757) < 10.0
    # Enter in the search resets nothing, the button does, as one step
    driver.bot.keyClick(dialog.search, Qt.Key.Key_Return)
    assert state.settings.theme == "light"
    driver.click(dialog.reset)
    assert (state.settings.theme, state.settings.pressure_unit) == ("system", "kPa")
    assert window.undo_stack.undoText() == "settings"
    window.undo_stack.undo()
    assert (state.settings.theme, state.settings.pressure_unit) == ("light", "psi")
    # what is changed elsewhere is shown here
    driver.trigger("Playback › Loop")
    assert controls["loop"].isChecked()
    dialog.close()
