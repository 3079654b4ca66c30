"""How much later or earlier a colour image is than the depth image of the same moment.

Depth cameras filter in time, and their stamps are of the newest image that went in. What is seen
here is only reported: frames are paired by their stamps and `Frame.colour_delay_s`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bubbleviz.calibration.contact_free import LAG, find_contact_free, tile_depths
from bubbleviz.camera import ColourImage, readable
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import MIN_FRAMES, Recording, mean_inflation
from bubbleviz.shear import FlowPreset, OpticalFlow

MOST_S = 0.3  # longest lag looked for: depth filters of some ten frames

_STEP_S = 1e-3
_LAGS_S = _STEP_S * np.arange(round(-MOST_S / _STEP_S), round(MOST_S / _STEP_S) + 1)
_ALIKE = 0.9  # least correlation of the two curves; chosen: noise does not reach it
_ONSET_S = 0.25
"""Time after the first contact in which the curves are compared. Depth and texture move in
proportion only as a contact begins: a drag, later, moves the texture alone. Tuned on renderings of
`shared/data/rubber_truth`, whose stamps are equal, and on the real press."""
_BEFORE, _AFTER = 40, 60  # frames around the first contact that are looked at; chosen
_FASTEST: FlowPreset = "fast"  # its error is small beside the motion of a press
_MOVED_MOST = 0.95  # quantile over the image: what a small contact moves, and not one outlier


@dataclass(frozen=True)
class TemporalLag:
    """Delay of the colour images that is seen in a recording."""

    # stamp of a colour image minus that of the depth image of the same moment, s: negative where
    # colour leads depth
    lag_s: float
    # 95 % interval of it, s, by the noise and by how unlike the two motions are
    interval_s: tuple[float, float]

    def to_text(self) -> str:
        """One clause, with units."""
        low, high = self.interval_s
        return (
            f"colour delay of {self.lag_s:.3f} s seen at the first contact "
            f"(95 %: {low:.3f} to {high:.3f} s), not applied"
        )


def temporal_lag(recording: Recording, progress: Progress = quiet) -> TemporalLag:
    """Lag by the first contact of a recording, in which flow and depth change together.

    Raises InputError: there are no colour images, nothing is touched, or colour and depth do not
    change together.
    """
    if recording.colour is None:
        raise InputError(f"{recording.path}: has no colour images of this sensor")
    first = len(find_contact_free(recording, progress).frames)
    chosen = range(max(0, first - _BEFORE), min(len(recording), first + _AFTER))
    tiles: list[np.ndarray] = []
    images: dict[int, ColourImage] = {}
    for k in chosen:
        frame = recording[k]
        tiles.append(tile_depths(frame.depth_m))
        colour = frame.colour
        if colour is not None:
            images[k] = colour
        progress("reading colour images", (k - chosen[0] + 1) / len(chosen))
    greys = readable(images)
    untouched = [grey for k, grey in greys.items() if k < first - LAG]
    if len(untouched) < MIN_FRAMES or first == len(recording):
        raise InputError(
            f"{recording.path}: no contact with at least {MIN_FRAMES} colour images before it"
        )
    flow = OpticalFlow.of(untouched, _FASTEST)
    if flow.problem:
        raise InputError(f"{recording.path}: {flow.problem}")
    times_s = np.array([images[k].time_s for k in greys])
    moved = np.array([_moved(flow, grey) for grey in greys.values()])
    rest = np.median(tiles[: first - LAG - chosen[0]], axis=0)
    change = np.nanquantile(np.abs(np.array(tiles) - rest), _MOVED_MOST, axis=1)
    try:
        onset_s = float(recording.times_s[first])
        return lag_between(recording.times_s[list(chosen)], change, times_s, moved, onset_s)
    except ValueError as error:
        raise InputError(f"{recording.path}: {error}") from error


def lag_between(
    # depth_times_s, depth: (n,), times, s, and how far the depth image has changed, in any unit
    depth_times_s: np.ndarray,
    depth: np.ndarray,
    # colour_times_s, colour: (m,), the same of the colour images; interpolated
    colour_times_s: np.ndarray,
    colour: np.ndarray,
    onset_s: float,  # when the change of depth begins, s
) -> TemporalLag:
    """Lag at which two curves begin to change most alike, up to scale and offset.

    Raises ValueError: they have too little time in common, or are not alike at any lag.
    """
    texture = _Curve.of(colour_times_s, colour)
    shape = _Curve.of(depth_times_s, depth)
    if min(len(texture.values), len(shape.values)) < MIN_FRAMES:
        raise ValueError("texture or depth is not found again")
    lag, sigma, alike = _fit(shape, texture, onset_s, _ONSET_S)
    if alike < _ALIKE or abs(lag) > MOST_S - 2.0 * _STEP_S:
        raise ValueError("colour and depth do not change together")
    others = [_fit(shape, texture, onset_s, share * _ONSET_S)[0] for share in (0.5, 2.0)]
    unlike = max(abs(other - lag) for other in others)
    half = 1.96 * float(np.sqrt(sigma**2 + unlike**2 + _STEP_S**2))
    return TemporalLag(lag, (lag - half, lag + half))


class _Curve(NamedTuple):
    """How far something has changed at times, s."""

    times_s: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, times_s: np.ndarray, values: np.ndarray) -> _Curve:
        known = np.isfinite(values)
        return cls(times_s[known], values[known])

    def at(self, times_s: np.ndarray, window_s: np.ndarray) -> np.ndarray:
        """Means over a window about each time."""
        return np.interp(times_s + window_s[:, None], *self).mean(axis=0)


def _fit(depth: _Curve, colour: _Curve, onset_s: float, after_s: float) -> tuple[float, ...]:
    """Lag, its error by noise, s, and correlation, up to a time after the onset."""
    start, end = colour.times_s[0] + MOST_S, colour.times_s[-1] - MOST_S
    last = min(end, onset_s + after_s)
    times = depth.times_s[(depth.times_s >= start) & (depth.times_s <= last)]
    if len(times) < 2 * MIN_FRAMES or times[-1] <= onset_s:
        raise ValueError("colour and depth have too little time in common")
    # over two periods: else noise, which is less between samples than at them, draws the lag there
    period = float(np.median(np.diff(depth.times_s)))
    window = np.linspace(-period, period, 9)
    curve = depth.at(times, window)
    centred = curve - curve.mean()
    moved = np.array([colour.at(times + lag, window) for lag in _LAGS_S])
    shifted = moved - moved.mean(axis=1, keepdims=True)
    length = np.linalg.norm(centred) * np.linalg.norm(shifted, axis=1)
    alike = shifted @ centred / np.maximum(length, 1e-300)
    best = int(np.clip(np.argmax(alike), 1, len(_LAGS_S) - 2))
    slope = (shifted[best] @ centred) / max(shifted[best] @ shifted[best], 1e-300)
    left = centred - slope * shifted[best]
    rate = slope * (moved[best + 1] - moved[best - 1]) / (2.0 * _STEP_S)
    noise = left @ left / (len(left) - 3) * mean_inflation(_autocorrelation(left))
    sigma = float(np.sqrt(noise / max(rate @ rate, 1e-300)))
    return float(_LAGS_S[best]), sigma, float(alike[best])


def _moved(flow: OpticalFlow, grey: np.ndarray) -> float:
    """How far the texture moved where it moved most, pixels; NaN where none is found."""
    moved = np.linalg.norm(flow.measure(grey).moved_px, axis=1)
    return float(np.quantile(moved, _MOVED_MOST)) if len(moved) else np.nan


def _autocorrelation(values: np.ndarray) -> np.ndarray:
    full = np.correlate(values, values, "full")[len(values) - 1 :]
    return np.asarray(full / max(full[0], 1e-300))
