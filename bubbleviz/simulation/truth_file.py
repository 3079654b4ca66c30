"""TRUTH.npz of a simulation, and recordings with their ground truth."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.files import TRUTH_SUFFIX, as_input_error, read_npz
from bubbleviz.recordings import Frame, FrameSource, Recording
from bubbleviz.simulation.synthetic_source import Truth
from bubbleviz.wording import count_of, width_by_height

KEYS = (*(f.name for f in fields(Truth) if f.default is MISSING), "time_s", "T_B_O")
"""Required keys of a TRUTH.npz; a RESULT.npz has no T_B_O."""
OPTIONAL_KEYS = tuple(f.name for f in fields(Truth) if f.default is not MISSING)
"""Missing in files of version 0.2.0 and before."""
_TIME_TOLERANCE_S = 1e-3
"""Largest difference of times of the same frame; those of a recording are rounded to ns."""


class OtherTruthError(InputError):
    """A TRUTH.npz belongs to another recording."""


class RecordingWithTruth:
    """A recording of a simulation with its ground truth.

    Attributes
    ----------
    name : str
    path : Path
    times_s : (F,) array

    Raises
    ------
    InputError
        The truth cannot be read, or belongs to another recording.
    """

    def __init__(
        self,
        recording: Recording,  # closed with this one
        truth_file: Path,
    ) -> None:
        self._recording, self._truth = recording, read_truth(truth_file)
        self.name, self.path, self.times_s = recording.name, recording.path, recording.times_s
        times, masks = self._truth["time_s"], self._truth["patch_mask"]
        same = len(times) == len(recording) and bool(
            (np.abs(times - times[0] - recording.times_s) < _TIME_TOLERANCE_S).all()
        )
        if not same or masks.shape[1:] != recording.size[::-1]:
            own = _described(len(recording), (0, *recording.size[::-1]))
            other = _described(len(times), masks.shape)
            how = "other frame times" if other == own else f"{other}, not {own}"
            raise OtherTruthError(
                f"{truth_file}: belongs to another recording than {recording.path} ({how}); choose "
                "the TRUTH.npz written with this recording"
            )

    def __len__(self) -> int:
        """Count the frames."""
        return len(self._recording)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`."""
        return self._recording[index]

    def truth(self, index: int) -> Truth:
        """Ground truth of frame `index`."""
        known = [field.name for field in fields(Truth) if field.name in self._truth]
        return Truth(**{name: self._truth[name][index] for name in known})

    def close(self) -> None:
        """Close files."""
        self._recording.close()


def read_truth(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a TRUTH.npz by `KEYS` and `OPTIONAL_KEYS`, each with one row per frame.

    Raises InputError: it cannot be read, or is not a TRUTH.npz.
    """
    with as_input_error(path, "the ground truth", "simulate it again, or correct the path"):
        arrays = read_npz(path)
    missing = [key for key in KEYS if key not in arrays]
    if missing:
        raise InputError(
            f"{path}: not a TRUTH.npz of bubbleviz simulate (it lacks {missing[0]}); "
            "choose another file"
        )
    arrays = {key: arrays[key] for key in (*KEYS, *OPTIONAL_KEYS) if key in arrays}
    counts = {len(array) if array.ndim else 0 for array in arrays.values()}
    if len(counts) != 1 or 0 in counts or arrays["patch_mask"].ndim != 3:
        raise InputError(f"{path}: its arrays have inconsistent shapes; simulate it again")
    return arrays


def with_truth_file(recording: FrameSource) -> FrameSource:
    """The recording with the ground truth of the file of its name and suffix .npz, if any.

    Returns the recording unchanged if there is none, or the file is not a TRUTH.npz, but for
    example a RESULT.npz. A TRUTH.npz of another recording is mentioned in its note.
    """
    if not isinstance(recording, Recording):
        return recording
    original = recording.path.absolute()
    stem = original.name if original.is_dir() else original.stem
    path = original.with_name(f"{stem}{TRUTH_SUFFIX}")
    if not path.is_file():
        return recording
    try:
        return RecordingWithTruth(recording, path)
    except OtherTruthError as error:
        recording.note = "; ".join(filter(None, (recording.note, str(error))))
    except InputError:
        pass
    return recording


def _described(frames: int, shape: tuple[int, ...]) -> str:
    return f"{count_of(frames, 'frame')} of {width_by_height(shape[1:])} pixels"
