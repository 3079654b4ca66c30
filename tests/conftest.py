"""What tests of every part share."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does, see bubbleviz/cli.py
_SETTINGS = TemporaryDirectory(prefix="bubbleviz-tests-")
os.environ["XDG_CONFIG_HOME"] = _SETTINGS.name  # not the user's own session

REPOSITORY = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def punyo_press() -> Path:
    """The real recording of a press, where this machine has it."""
    path = REPOSITORY.parent / "shared" / "data" / "punyo_press_a"
    if not path.is_dir():
        pytest.skip("the real recording punyo_press_a is not on this machine")
    return path
