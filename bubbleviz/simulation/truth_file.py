"""TRUTH.npz of a simulation, and recordings with their ground truth."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.files import TRUTH_SUFFIX, damage, read_npz
from bubbleviz.recordings import Frame, FrameSource, Recording
from bubbleviz.simulation.synthetic_source import Truth
from bubbleviz.wording import count_of

KEYS = (*(f.name for f in fields(Truth) if f.default is MISSING), "time_s", "T_B_O")
"""What a TRUTH.npz has; T_B_O tells it from a RESULT.npz."""
MORE = tuple(f.name for f in fields(Truth) if f.default is not MISSING)
"""What it may have besides: those of version 0.2.0 and before do not."""
SAME_S = 1e-3
"""Times of the same frame differ by no more: those of a recording are whole nanoseconds."""


class OtherTruthError(InputError):
    """A TRUTH.npz is of another recording."""


class KnownRecording:
    """A recording of a simulation with the truth about its frames.

    Attributes
    ----------
    name : str
    path : Path
    times_s : (F,) array

    Raises
    ------
    InputError
        The truth cannot be read, or is of another recording.
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
            (np.abs(times - times[0] - recording.times_s) < SAME_S).all()
        )
        if not same or masks.shape[1:] != recording.size[::-1]:
            raise OtherTruthError(
                f"{truth_file}: belongs to another recording than {recording.path}, of "
                f"{_described(len(times), masks.shape)} and not "
                f"{_described(len(recording), (0, *recording.size[::-1]))}; choose the TRUTH.npz "
                "that was written with it"
            )

    def __len__(self) -> int:
        """Count the frames."""
        return len(self._recording)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`."""
        return self._recording[index]

    def truth(self, index: int) -> Truth:
        """What is true of frame `index`."""
        known = [field.name for field in fields(Truth) if field.name in self._truth]
        return Truth(**{name: self._truth[name][index] for name in known})

    def close(self) -> None:
        """Close files."""
        self._recording.close()


def read_truth(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a TRUTH.npz by `KEYS` and as many of `MORE` as it has, each with a row a frame.

    Raises InputError: it cannot be read, or is no truth of a simulation.
    """
    with damage(path, "the truth", "check it"):
        arrays = read_npz(path)
    missing = [key for key in KEYS if key not in arrays]
    if missing:
        raise InputError(
            f"{path}: not a TRUTH.npz of bubbleviz simulate (no {missing[0]} in it); "
            "choose another file"
        )
    arrays = {key: arrays[key] for key in (*KEYS, *MORE) if key in arrays}
    counts = {len(array) if array.ndim else 0 for array in arrays.values()}
    if len(counts) != 1 or 0 in counts or arrays["patch_mask"].ndim != 3:
        raise InputError(f"{path}: its arrays are inconsistent; simulate it again")
    return arrays


def known_beside(recording: FrameSource) -> FrameSource:
    """The recording with the truth of the TRUTH.npz beside it that is named after it.

    Where there is none, or a file of that name is something else, such as its RESULT.npz, it is
    the recording as it was: nobody has said that it is a simulation. It remarks on a truth that is
    not its own.
    """
    if not isinstance(recording, Recording):
        return recording
    place = recording.path.absolute()
    path = place.with_name(f"{place.name if place.is_dir() else place.stem}{TRUTH_SUFFIX}")
    if not path.is_file():
        return recording
    try:
        return KnownRecording(recording, path)
    except OtherTruthError as error:
        recording.remark = "; ".join(filter(None, (recording.remark, str(error))))
    except InputError:
        pass
    return recording


def _described(frames: int, shape: tuple[int, ...]) -> str:
    return f"{count_of(frames, 'frame')} of {shape[2]}×{shape[1]} pixels"
