"""Recordings in every format the reader opens."""

import pytest
from bagmaker import KINDS, BagMaker, fill


@pytest.fixture(params=KINDS)
def press(request, tmp_path):
    """A small recording in every format."""
    return fill(BagMaker(request.param)).write(tmp_path)
