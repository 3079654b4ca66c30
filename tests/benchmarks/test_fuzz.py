"""A short run of the damaged and hostile inputs; all of them by `python -m benchmarks fuzz`."""

import os

import pytest

from benchmarks.fuzz import KINDS, fuzz, to_text

INPUTS = 270 if "TEST_ALL" in os.environ else 4 * len(KINDS)


def test_every_input_is_read_or_refused_in_one_line(tmp_path):
    outcomes = list(fuzz(range(INPUTS), 0, tmp_path))
    assert len(outcomes) == INPUTS
    assert not any(each.fault for each in outcomes), to_text(outcomes)


def broken(corpus, folder, rng):
    return lambda: {}["key"]


def endless(corpus, folder, rng):
    while True:
        pass


@pytest.mark.long
def test_fuzzing_finds_a_planted_fault(tmp_path, monkeypatch):
    """One reader raises another error than InputError, one never returns."""
    monkeypatch.setattr("benchmarks.fuzz.TIMEOUT_S", 1.0)
    monkeypatch.setattr("benchmarks.fuzz.KINDS", {"broken": broken, "endless": endless})
    faults = [each.fault for each in fuzz(range(3), 0, tmp_path)]
    assert faults[0].startswith("KeyError at test_fuzz.py")
    assert faults[1] == "no answer within 1 s"
    assert faults[2] == faults[0]
