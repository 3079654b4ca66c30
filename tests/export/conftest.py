"""The estimate of the small press, which the exports must reproduce."""

import numpy as np
import pytest

import bubbleviz as bv


@pytest.fixture(scope="session")
def estimated(press, sensor, tmp_path_factory):
    """RESULT.npz of the press."""
    out = tmp_path_factory.mktemp("estimated") / "result.npz"
    bv.estimate(bv.open(press), sensor, out=out)
    with np.load(out) as file:
        return {key: file[key] for key in file.files}
