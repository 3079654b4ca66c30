"""Fixtures shared by the tests of live sources."""

import threading

import pytest
from wire import HEIGHT, WIDTH

from bubbleviz.sensor import load_sensor, sensor_to_toml
from bubbleviz.simulation import resized, with_nodes


@pytest.fixture(autouse=True)
def no_threads_left():
    """Fail a test that leaves a source running, which would slow every test after it."""
    before = set(threading.enumerate())
    yield
    others = ("tqdm_monitor", "Dummy-")  # of libraries, once a process
    new = [t for t in threading.enumerate() if t not in before and not t.name.startswith(others)]
    for thread in new:
        thread.join(10.0)
    assert not [thread.name for thread in new if thread.is_alive()]


@pytest.fixture(scope="session")
def small_sensor():
    """The preset with a coarse mesh and few pixels, looking at the same dome."""
    return with_nodes(resized(load_sensor("pico_flexx_75mm"), WIDTH, HEIGHT), 300)


@pytest.fixture(scope="session")
def small_sensor_file(small_sensor, tmp_path_factory):
    """The same as a file."""
    path = tmp_path_factory.mktemp("sensor") / "small.toml"
    path.write_text(sensor_to_toml(small_sensor))
    return path
