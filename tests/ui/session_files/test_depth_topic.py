"""A recording of two sensors: the window shows the one whose depth topic is chosen."""

from fakes import DentSource
from PySide6.QtWidgets import QMenu

from bubbleviz.recordings import Recording
from bubbleviz_ui.engine.source import Source
from tests.recordings.bagmaker import START, BagMaker

LEFT, RIGHT = "/left/depth/image", "/right/depth/image"


def recording(folder, sensor):
    """Twelve frames of a dent on the left, the first three of them also on the right."""
    bag = BagMaker("mcap file")
    for k, frame in enumerate(DentSource(sensor)):
        for topic in (LEFT, RIGHT)[: 1 + (k < 3)]:
            bag.image(START + k * 10**8, frame.depth_m, topic=topic)
    return bag.write(folder)


def topics(driver):
    menu = next(m for m in driver.window.findChildren(QMenu) if m.title() == "Depth to&pic")
    assert menu.isEnabled() == (len(menu.actions()) > 1)
    return {action.text(): action for action in menu.actions()}


def test_another_depth_topic_is_chosen_in_the_file_menu(drive, sensor, tmp_path):
    path, saved = recording(tmp_path, sensor), tmp_path / "right.bubbleviz"
    with Recording(path, depth_topic=RIGHT) as right:
        assert (right.depth_topics, len(right)) == ([LEFT, RIGHT], 3)
    driver = drive()
    assert not topics(driver)  # of another source
    driver.open("both", Source.of_recording(path), sensor, frame=8, playing=False)
    driver.wait(lambda: driver.state.facts.frames == 12)
    assert "/right/depth/image" in driver.message_text
    assert topics(driver)[LEFT].isChecked() and not topics(driver)[RIGHT].isChecked()
    topics(driver)[RIGHT].trigger()
    driver.wait(lambda: driver.state.facts.frames == 3)
    assert topics(driver)[RIGHT].isChecked() and not topics(driver)[LEFT].isChecked()
    driver.window.session_saver.save_as(saved)
    topics(driver)[LEFT].trigger()
    driver.wait(lambda: driver.state.facts.frames == 12)
    driver.window.files.open(saved)
    driver.wait(lambda: driver.state.facts.frames == 3)
    driver.trigger("File › Reload")
    driver.wait_until_shown()
    assert driver.state.facts.depth_topic == RIGHT
