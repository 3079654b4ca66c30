"""Recordings in every format the reader opens."""

from __future__ import annotations

from pathlib import Path

import pytest
from bagmaker import KINDS, BagMaker, fill


@pytest.fixture(params=KINDS)
def press(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A small recording in every format."""
    return fill(BagMaker(request.param)).write(tmp_path)
