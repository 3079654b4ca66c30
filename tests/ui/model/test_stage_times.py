"""The performance table, against the counts of the pipeline."""

from PySide6.QtWidgets import QApplication

from bubbleviz_ui.model.demand import STAGES
from bubbleviz_ui.panels.status_bar import IDLE, PerformancePopup


def rows(popup):
    """Texts of each line by stage."""
    return {
        stage: [popup.table.item(row, column).text() for column in range(1, 5)]
        for row, stage in enumerate(STAGES)
    }


def test_click_on_the_status_bar_opens_the_performance_table(drive):
    driver = drive(frame=3)
    driver.resize(1500, 800)  # with room for the rates
    for frame in (4, 5, 6):
        driver.seek(frame)
    driver.click(driver.window.status.labels["solve"])
    popup = driver.window.findChildren(PerformancePopup)[-1]
    driver.bot.waitExposed(popup)
    table = popup.table
    for row in range(table.rowCount()):  # no text is clipped
        for column in range(4):
            text = table.item(row, column).text()
            assert table.fontMetrics().horizontalAdvance(text) < table.columnWidth(column), text
    assert not table.verticalScrollBar().isVisible()
    seen, counts = rows(popup), driver.pipeline.counts
    for stage in STAGES:
        assert seen[stage][2] == f"{counts[stage]}×"
    last, median, _, why = seen["estimate"]
    result = driver.result
    assert last == driver.state.units.duration.text(result.times_ms["estimate"])
    assert median.endswith(" ms") and "Membrane" in why and "status bar" in why
    assert "Rim" not in why  # which needs nothing
    assert seen["pixel_mask"][3] == IDLE and seen["pixel_mask"][2] == "0×"
    driver.state.change(layers=frozenset({"rim"}))
    popup.refresh()
    seen = rows(popup)
    assert seen["cloud"][3] == IDLE and "Membrane" not in seen["estimate"][3]
    popup.close()
    before = driver.pipeline.counts["cloud"]
    driver.seek(7)
    assert driver.pipeline.counts["cloud"] == before
    QApplication.processEvents()
