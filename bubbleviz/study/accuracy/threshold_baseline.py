"""Baseline: threshold on the depth difference, with the best threshold chosen by an oracle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.study.truth_bank import Sighting, TruthBank, noise_name

THRESHOLDS_M = np.geomspace(1e-4, 4e-2, 120)  # from below noise to above any press


@dataclass(frozen=True)
class Baseline:
    """Patch as the pixels whose range changed by more than a threshold.

    Attributes
    ----------
    object_name : str
    noise : str
    blur_px : float
        σ of a Gaussian blur of the range change before the threshold; 0 is the usual baseline.
    threshold_m : float
        The one threshold with the best mean IoU over the object's presses.
    iou : float
        That mean.
    """

    object_name: str
    noise: str
    blur_px: float
    threshold_m: float
    iou: float


def oracle_baseline(
    bank: TruthBank, sightings: list[Sighting], noise: DepthNoise, blur_px: float, index: int
) -> Baseline:
    """Baseline on presses of one object, with the threshold that an oracle picks for them."""
    scores = np.mean([iou_by_threshold(bank, s, noise, blur_px, index) for s in sightings], axis=0)
    best = int(np.argmax(scores))
    return Baseline(
        sightings[0].press.object_name,
        noise_name(noise),
        blur_px,
        float(THRESHOLDS_M[best]),
        float(scores[best]),
    )


def iou_by_threshold(
    bank: TruthBank, sighting: Sighting, noise: DepthNoise, blur_px: float, index: int
) -> np.ndarray:
    """IoU for each of the thresholds (t,)."""
    frame = bank.frame(sighting, noise, index)
    change = np.nan_to_num(bank.camera.range_image(frame.depth_m) - bank.rest_range_m)
    if blur_px > 0.0:
        change = gaussian_filter(change, blur_px)
    change, patch = np.abs(change), sighting.truth.patch_mask
    hit, wrong = (_count_above(change[mask]) for mask in (patch, ~patch))
    return hit / (np.count_nonzero(patch) + wrong)


def _count_above(values: np.ndarray) -> np.ndarray:
    """How many values exceed each threshold (t,)."""
    return values.size - np.searchsorted(np.sort(values), THRESHOLDS_M, side="right")
