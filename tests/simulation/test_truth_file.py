"""TRUTH.npz is read back with its recording, or refused with the reason."""

import shutil

import numpy as np
import pytest
from small_press import small_source

from bubbleviz.api.simulating import Simulation
from bubbleviz.errors import InputError
from bubbleviz.recordings import Recording
from bubbleviz.simulation import RecordingWithTruth, read_truth, with_truth_file

FRAMES = 3


@pytest.fixture(scope="module")
def source(sensor):
    return small_source(sensor, (0.06, 0.045, 0.040))


@pytest.fixture(scope="module")
def folder(source, tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated")
    Simulation(source).save(folder / "sim.mcap", folder / "truth.npz")
    return folder


def test_ground_truth_of_the_same_name_is_found_and_a_result_file_is_not(folder, tmp_path):
    for name in ("sim.mcap", "truth.npz"):
        shutil.copy(folder / name, tmp_path)
    with Recording(tmp_path / "sim.mcap") as recording:
        assert with_truth_file(recording) is recording
        arrays = dict(np.load(tmp_path / "truth.npz"))
        del arrays["T_B_O"]  # as RESULT.npz, which has most of the other names
        np.savez(tmp_path / "sim.npz", **arrays)
        assert with_truth_file(recording) is recording
        (tmp_path / "sim.npz").write_bytes(b"no npz")
        assert with_truth_file(recording) is recording
        shutil.copy(tmp_path / "truth.npz", tmp_path / "sim.npz")
        assert isinstance(with_truth_file(recording), RecordingWithTruth) and not recording.note
        of_another = {name: array[:-1] for name, array in np.load(tmp_path / "truth.npz").items()}
        np.savez(tmp_path / "sim.npz", **of_another)
        assert with_truth_file(recording) is recording
        assert "sim.npz: belongs to another recording" in recording.note


def test_ground_truth_of_another_recording_gives_one_sentence(folder, tmp_path):
    arrays = dict(np.load(folder / "truth.npz"))
    bad = tmp_path / "bad.npz"

    def problem():
        with Recording(folder / "sim.mcap") as recording, pytest.raises(InputError) as caught:
            RecordingWithTruth(recording, bad)
        assert "bad.npz" in str(caught.value) and "\n" not in str(caught.value)
        return str(caught.value)

    assert "cannot be read" in problem()
    bad.write_bytes(b"PK no zip")
    assert "cannot be read" in problem()
    np.savez(bad, force_n=arrays["force_n"])
    assert "not a TRUTH.npz" in problem()
    np.savez(bad, **{**arrays, "patch_mask": np.array(True)})
    assert "have inconsistent shapes" in problem()
    np.savez(bad, **{k: a[:2] if len(a) == FRAMES else a for k, a in arrays.items()})
    assert "2 frames" in problem() and "3 frames" in problem()
    np.savez(bad, **{**arrays, "patch_mask": arrays["patch_mask"][:, :, 1:]})
    assert "55×43" in problem() and "56×43" in problem()
    np.savez(bad, **{**arrays, "time_s": 2.0 * arrays["time_s"]})
    assert "another recording" in problem()
    np.savez(bad, **{**arrays, "force_n": np.array([{}] * FRAMES, dtype=object)})
    with pytest.raises(InputError, match="cannot be read"):
        read_truth(bad)
