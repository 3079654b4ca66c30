"""Fixtures shared by the tests of the documentation."""

import pytest
from pages import REPOSITORY

REAL = REPOSITORY.parent / "shared" / "data" / "punyo_press_a"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A new working folder, with links to the data on this machine."""
    work = tmp_path / "work"
    work.mkdir()
    if REAL.is_dir():
        (tmp_path / "shared" / "data").mkdir(parents=True)
        (tmp_path / "shared" / "data" / REAL.name).symlink_to(REAL)
    monkeypatch.chdir(work)
    return work
