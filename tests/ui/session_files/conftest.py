"""A short recording and the file of its coarse sensor, opened in a window."""

import pytest
from fakes import FRAMES, DentSource, record, small_sensor

from bubbleviz.sensor import load_sensor, sensor_to_toml
from bubbleviz_ui.engine.source import Source


@pytest.fixture(scope="session")
def sensor():
    return small_sensor(nodes=80)


@pytest.fixture
def files(tmp_path, sensor):
    """A folder with the recording `press.mcap` and the sensor file `dome.toml`."""
    folder = tmp_path / "mine"
    folder.mkdir()
    record(folder / "press.mcap", DentSource(sensor))
    (folder / "dome.toml").write_text(sensor_to_toml(sensor))
    return folder


@pytest.fixture
def open_press(files):
    """Open the recording, or its copy in another folder, in a window."""

    def opened(driver, folder=files, **at):
        source = Source.of_recording(folder / "press.mcap")
        former = driver.window.controller.client.session
        driver.open("press", source, load_sensor(files / "dome.toml"), playing=False, **at)
        driver.wait(lambda: driver.window.controller.client.session is not former)
        driver.wait(lambda: driver.state.facts.frames == FRAMES)

    return opened
