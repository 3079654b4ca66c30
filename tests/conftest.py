"""What tests of every part share."""

from __future__ import annotations

from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def punyo_press() -> Path:
    """The real recording of a press, where this machine has it."""
    path = REPOSITORY.parent / "shared" / "data" / "punyo_press_a"
    if not path.is_dir():
        pytest.skip("the real recording punyo_press_a is not on this machine")
    return path
