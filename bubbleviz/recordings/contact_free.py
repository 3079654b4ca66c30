"""Find the contact-free frames at the start of a recording, with or without gas pressure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings.depth_statistics import LAG, MAD_TO_SIGMA, MIN_FRAMES, robust_sigma
from bubbleviz.recordings.frame import FrameSource
from bubbleviz.wording import count_of

SIGNIFICANT = 6.0  # standard deviations, which noise practically never exceeds

_TILE_PX = 8  # side; chosen: 64 samples average noise out, a fingertip still fills several tiles
_COVERED = 0.01  # smallest share of the image that a contact changes
_SUSTAINED = 3  # frames in a row; a shorter change is a glitch


@dataclass(frozen=True)
class ContactFree:
    """The leading contact-free frames of a recording."""

    frames: range  # indices 0 … end − 1
    # (F,), change from rest of the most changed 1 % of the image, standard deviations
    depth_score: np.ndarray
    # (F,), the same for the gas pressure; None where the recording has none
    pressure_score: np.ndarray | None
    ended_by: str  # the measurement that first showed contact; `recording`: none did


def find_contact_free(source: FrameSource, progress: Progress = quiet) -> ContactFree:
    """Leading frames in which neither the depth nor the gas pressure has left its rest state.

    The recording must start without contact: a contact present from the first frame that never
    changes cannot be distinguished from the dome's shape.

    Raises InputError: fewer than 5 frames before the first change.
    """
    tiles, pressures = _summaries(source, progress)
    depth_score = _score(tiles)
    depth_end = _first_change(depth_score)
    end, ended_by = (depth_end, "depth") if depth_end < len(tiles) else (len(tiles), "recording")
    pressure_score = None
    if pressures is not None:
        pressure_score = _score(pressures[:, None])
        pressure_end = _first_change(pressure_score)
        if pressure_end < end:
            end, ended_by = pressure_end, "pressure"
    if end < MIN_FRAMES:
        what = "gas pressure" if ended_by == "pressure" else "depth"
        raise InputError(
            f"{source.name}: the {what} already changes at frame {end} (from 0); record at least "
            f"{MIN_FRAMES} frames before contact, or choose contact-free frames yourself"
        )
    return ContactFree(range(end), depth_score, pressure_score, ended_by)


def _summaries(source: FrameSource, progress: Progress) -> tuple[np.ndarray, np.ndarray | None]:
    """Depth of every tile (F, K) in m and gas pressure (F,) in Pa, None if a frame lacks it."""
    if len(source) < MIN_FRAMES:
        raise InputError(
            f"{source.name}: only {count_of(len(source), 'frame')}, too few to find contact-free "
            f"ones; record at least {MIN_FRAMES} without contact"
        )
    tiles, pressures = [], []
    for k in range(len(source)):
        frame = source[k]
        tiles.append(tile_depths(frame.depth_m))
        pressures.append(frame.gas_pressure_pa)
        progress("finding contact-free frames", (k + 1) / len(source))
    known = np.array([np.nan if p is None else p for p in pressures])
    return np.array(tiles), known if np.isfinite(known).all() else None


def tile_depths(depth: np.ndarray) -> np.ndarray:
    """Interquartile mean of the depth in each 8×8 tile, m; NaN where half of it has no return.

    As robust to false returns as the median, without its quantisation.
    """
    rows, columns = (side // _TILE_PX * _TILE_PX for side in depth.shape)
    tiles = rows // _TILE_PX, _TILE_PX, columns // _TILE_PX, _TILE_PX
    blocks = depth[:rows, :columns].reshape(tiles).transpose(0, 2, 1, 3)
    samples = np.sort(blocks.reshape(-1, _TILE_PX**2), axis=1)
    count = np.isfinite(samples).sum(axis=1)[:, None]
    order = np.arange(_TILE_PX**2)
    middle = (order >= count // 4) & (order < count - count // 4)
    total = np.sum(samples, axis=1, where=middle, dtype=np.float64)
    mean = total / np.maximum(middle.sum(axis=1), 1)
    return np.where(2 * count[:, 0] >= _TILE_PX**2, mean, np.nan)


def _score(values: np.ndarray) -> np.ndarray:
    """Standard deviations by which the most changed 1 % of the columns are from rest, (F,)."""
    values = values[:, np.isfinite(values).all(axis=0)]
    if values.shape[1] == 0:
        return np.zeros(len(values))
    sigma = _sigma_at_rest(values)
    typical = float(np.median(sigma))
    # Quantised columns may never change at all: their spread is at least the typical one, and
    # never below the numerical resolution.
    sigma = np.maximum(sigma, max(typical, np.finfo(float).eps * float(np.abs(values).max())))
    end = MIN_FRAMES
    score = np.zeros(len(values))
    for _ in range(4):  # rest state from more frames, as they are found to be at rest
        rest = np.median(values[:end], axis=0)
        score = np.quantile(np.abs(values - rest) / sigma, 1.0 - _COVERED, axis=1)
        found = max(MIN_FRAMES, _first_change(score))
        if found == end:
            break
        end = found
    return score


def _sigma_at_rest(values: np.ndarray) -> np.ndarray:
    """Standard deviation of each column (K,) of values (F, K) at rest.

    By differences over `LAG` frames, of which half may be of contact. Contact may fill most of a
    recording, but not its beginning: of the first F, F/2, F/4 … frames, those that differ least,
    where they differ significantly less than all.
    """
    chosen, usual = _differences(values)
    all_frames, count = usual, len(values) // 2
    while count >= 4 * LAG:
        differences, least = _differences(values[:count])
        error = robust_sigma(differences.mean(axis=1)) / np.sqrt(len(differences) / LAG)
        if 0.0 < least < min(usual, all_frames - SIGNIFICANT * error):
            chosen, usual = differences, least
        count //= 2
    # a rounded value may differ from itself in fewer than half of the frames
    step = np.where(chosen > 0.0, chosen, np.inf).min(axis=0)
    rounding = np.where(np.isfinite(step), step, 0.0) / np.sqrt(12.0)
    return np.maximum(MAD_TO_SIGMA * np.median(chosen, axis=0) / np.sqrt(2.0), rounding)


def _differences(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Magnitudes of differences over `LAG` frames, and their usual mean over the columns."""
    lag = min(LAG, len(values) - 1)
    differences = np.abs(values[lag:] - values[:-lag])
    return differences, float(np.median(differences.mean(axis=1)))


def _first_change(score: np.ndarray) -> int:
    """First frame of a sustained change from rest; the number of frames if there is none."""
    high = score > SIGNIFICANT
    runs = np.lib.stride_tricks.sliding_window_view(high, min(_SUSTAINED, len(high))).all(axis=1)
    starts = np.flatnonzero(runs)
    if not len(starts):
        return len(score)
    end = int(starts[0])
    before = max(0, end - 2 * LAG)
    usual = float(score[: max(before, 1)].max())
    while end > before and score[end - 1] > usual:  # back to the onset, before it was significant
        end -= 1
    return end
