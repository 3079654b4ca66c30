"""How much later or earlier a colour image is than the depth image of the same moment.

Depth cameras filter in time, and their stamps are of the newest image that went in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.calibration.rest.contact_free import LAG, find_contact_free, tile_depths
from bubbleviz.calibration.rest.depth_statistics import MIN_FRAMES
from bubbleviz.calibration.rest.noise_correlation import mean_inflation
from bubbleviz.colour.colour_image import ColourImage, readable
from bubbleviz.colour.optical_flow import FlowPreset, OpticalFlow
from bubbleviz.errors import InputError
from bubbleviz.frames.recording import Recording
from bubbleviz.progress import Progress, quiet

MOST_S = 0.3
"""Longest lag looked for: depth filters of some ten frames."""

_STEP_S = 1e-3
_ALIKE = 0.9  # least correlation of the two curves; chosen: noise does not reach it
_BEFORE, _AFTER = 40, 60  # frames around the first contact that are looked at; chosen
_FASTEST: FlowPreset = "fast"  # its error is small beside the motion of a press
_MOVED_MOST = 0.95  # quantile over the image: what a small contact moves, and not one outlier


@dataclass(frozen=True)
class TemporalLag:
    """Lag of the colour images behind the depth images.

    Attributes
    ----------
    lag_s : float
        Stamp of a colour image less that of the depth image of the same moment, s; negative where
        colour leads.
    sigma_s : float
        Its standard deviation, s.
    period_s : float
        Of the depth images, s.
    """

    lag_s: float
    sigma_s: float
    period_s: float

    def to_text(self) -> str:
        """One clause, with units."""
        lead = "colour leads depth" if self.lag_s <= 0.0 else "depth leads colour"
        frames = abs(self.lag_s) / self.period_s
        return (
            f"{lead} by {1e3 * abs(self.lag_s):.0f} ± {1e3 * self.sigma_s:.0f} ms "
            f"({frames:.1f} frames)"
        )


def temporal_lag(
    recording: Recording, progress: Progress = quiet, contact_free: range | None = None
) -> TemporalLag:
    """Lag by the first contact of a recording, in which flow and depth change together.

    Parameters
    ----------
    recording : Recording
    progress : callable, optional
    contact_free : range, optional
        Its leading contact-free frames; looked for where not given.

    Raises
    ------
    InputError
        There are no colour images, nothing is touched, or colour and depth do not change together.
    """
    if recording.colour is None:
        raise InputError(f"{recording.path}: has no colour images of this sensor")
    if contact_free is None:
        contact_free = find_contact_free(recording, progress).frames
    first = len(contact_free)
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
            f"{recording.path}: the lag of colour needs a contact, and at least {MIN_FRAMES} "
            "colour images before it"
        )
    flow = OpticalFlow.of(untouched, _FASTEST)
    if flow.problem:
        raise InputError(f"{recording.path}: no lag of colour, as {flow.problem}")
    times_s = np.array([images[k].time_s for k in greys])
    moved = np.array([_moved(flow, grey) for grey in greys.values()])
    rest = np.median(tiles[: first - LAG - chosen[0]], axis=0)
    change = np.nanquantile(np.abs(np.array(tiles) - rest), _MOVED_MOST, axis=1)
    try:
        return lag_between(recording.times_s[list(chosen)], change, times_s, moved)
    except ValueError as error:
        raise InputError(f"{recording.path}: no lag of colour, as {error}") from error


def lag_between(
    depth_times_s: np.ndarray, depth: np.ndarray, colour_times_s: np.ndarray, colour: np.ndarray
) -> TemporalLag:
    """Lag at which two curves are most alike, up to scale and offset.

    Parameters
    ----------
    depth_times_s, depth : (n,) array
        Times, s, and how far the depth image has changed, in any unit.
    colour_times_s, colour : (m,) array
        The same of the colour images; interpolated.

    Raises
    ------
    ValueError
        They have too little time in common, or are not alike at any lag.
    """
    colour_times_s, colour = _finite(colour_times_s, colour)
    depth_times_s, depth = _finite(depth_times_s, depth)
    if min(len(colour), len(depth)) < MIN_FRAMES:
        raise ValueError("texture or depth is not found again")
    start, end = colour_times_s[0] + MOST_S, colour_times_s[-1] - MOST_S
    times = depth_times_s[(depth_times_s >= start) & (depth_times_s <= end)]
    if len(times) < 2 * MIN_FRAMES:
        raise ValueError("colour and depth have too little time in common")
    period = float(np.median(np.diff(depth_times_s)))
    # over two periods: else noise, which is less between samples than at them, draws the lag there
    window = np.linspace(-period, period, 9)[:, None]
    curve = np.interp(times + window, depth_times_s, depth).mean(axis=0)

    def shifted(lag_s: float) -> np.ndarray:
        return np.interp(times + lag_s + window, colour_times_s, colour).mean(axis=0)

    lags = np.arange(-MOST_S, MOST_S + _STEP_S, _STEP_S)
    alike = np.nan_to_num([_correlation(curve, shifted(lag)) for lag in lags])
    best = int(np.argmax(alike))
    if alike[best] < _ALIKE or best in (0, len(lags) - 1):
        raise ValueError("they do not change together")
    lag = float(lags[best])
    slope, offset = np.polyfit(shifted(lag), curve, 1)
    left = curve - offset - slope * shifted(lag)
    rate = slope * (shifted(lag + _STEP_S) - shifted(lag - _STEP_S)) / (2.0 * _STEP_S)
    noise = left @ left / (len(left) - 3) * mean_inflation(_autocorrelation(left))
    sigma = float(np.hypot(np.sqrt(noise / (rate @ rate)), _STEP_S))
    return TemporalLag(lag, sigma, period)


def _moved(flow: OpticalFlow, grey: np.ndarray) -> float:
    """How far the texture moved where it moved most, pixels; NaN where none is found."""
    moved = np.linalg.norm(flow.measure(grey).moved_px, axis=1)
    return float(np.quantile(moved, _MOVED_MOST)) if len(moved) else np.nan


def _finite(times_s: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    known = np.isfinite(values)
    return times_s[known], values[known]


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-300))


def _autocorrelation(values: np.ndarray) -> np.ndarray:
    full = np.correlate(values, values, "full")[len(values) - 1 :]
    return np.asarray(full / max(full[0], 1e-300))
