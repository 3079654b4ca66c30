"""What tests of every part share."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # as the command line does, see bubbleviz/cli/command_line.py
_SETTINGS = TemporaryDirectory(prefix="bubbleviz-tests-")
os.environ["XDG_CONFIG_HOME"] = _SETTINGS.name  # not the user's own session

REPOSITORY = Path(__file__).parents[1]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where tests run in two processes: one for windows and live sources, which share a machine's
    screen and clock, the other for the rest, a file at a time."""
    for item in items:
        part = item.path.relative_to(REPOSITORY / "tests").parts[0]
        together = "window" if part in ("ui", "live") else item.path.name
        item.add_marker(pytest.mark.xdist_group(together))


@pytest.fixture(scope="session")
def punyo_press() -> Path:
    """The real recording of a press, where this machine has it."""
    path = REPOSITORY.parent / "shared" / "data" / "punyo_press_a"
    if not path.is_dir():
        pytest.skip("the real recording punyo_press_a is not on this machine")
    return path
