"""Results of the real press and three simulated ones equal those in `golden.json`."""

import json

import numpy as np
import pytest

from tests.golden.cases import FILE, PRESS, SIMULATED, made_with, real_press, simulated

GOLDEN = json.loads(FILE.read_text(encoding="utf-8"))


def compare(rows, golden, rtol=1e-3, force_atol=1e-5):
    """Exactly where the last digits are the same arithmetic, else closely."""
    exact = made_with() == GOLDEN["made_with"]
    assert [row["status"] for row in rows] == [row["status"] for row in golden]
    for row, known in zip(rows, golden, strict=True):
        assert row.keys() == known.keys()
        for key in row.keys() - {"status"}:
            if exact:
                np.testing.assert_array_equal(row[key], known[key])
            else:
                atol = force_atol if key == "force_n" else 1e-5
                np.testing.assert_allclose(row[key], known[key], rtol=rtol, atol=atol)


@pytest.mark.parametrize("name", SIMULATED)
def test_simulated_press_equals_stored_results(name):
    compare(simulated(name), GOLDEN[name])


def test_real_press_equals_stored_results():
    if not PRESS.is_dir():
        pytest.skip("punyo_press_a is not on this machine")
    # at the onset, contacts of two or three nodes hang on the last digits
    compare(real_press(), GOLDEN["real"], rtol=0.2, force_atol=0.1)
