"""A few short recordings of the small sensor."""

import shutil
from pathlib import Path

import pytest
from small_press import write_press


@pytest.fixture(scope="session")
def originals(tmp_path_factory, sensor):
    """Three good recordings, one of them in a folder below."""
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "day 1").mkdir()
    write_press(folder / "a.mcap", sensor)
    write_press(folder / "b.v2.mcap", sensor, (0.060, 0.043, 0.043), seed=1)
    write_press(folder / "day 1" / "c.mcap", sensor, (0.060, 0.060), seed=2)
    return folder


@pytest.fixture
def recordings(originals, tmp_path):
    """A copy that a test may change."""
    return Path(shutil.copytree(originals, tmp_path / "in"))
