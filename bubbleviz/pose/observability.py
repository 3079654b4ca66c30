"""Which ways an object can move without the contact noticing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DETERMINED_M = 4e-4
"""Standard deviation at the patch's edge below which contact determines a direction: better than
one patch of the size of the estimate's resolution alone, whose model error this is."""

_TURNS = 0.3
_LARGEST_RADIUS_M = 0.1
"""A motion that turns less than this share of the one that turns most is a shift; patches are
smaller than this."""

LEAST_RADIUS_M = 2e-3  # a smaller patch turns about itself as one of this radius does


@dataclass(frozen=True)
class Directions:
    """Six independent small motions, from the best determined to the least."""

    # (6, 6), in columns, in B about the patch's centre: translation, then rotation in rad, such
    # that a unit of each moves the patch's edge by about 1 m
    motions: np.ndarray
    # (6,), standard deviation of each at the patch's edge by the contact normals alone
    deviation_m: np.ndarray
    determined: np.ndarray  # (6,) bool

    @property
    def open(self) -> np.ndarray:
        """The motions that the contact does not determine, (6, q)."""
        return self.motions[:, ~self.determined]


def directions(surface: np.ndarray, radius_m: float) -> Directions:
    """Directions of the information (6, 6) of contact normals on a patch of some radius."""
    radius = max(radius_m, LEAST_RADIUS_M)
    unit = np.array([1.0, 1.0, 1.0, 1.0 / radius, 1.0 / radius, 1.0 / radius])
    information, vectors = np.linalg.eigh(surface * np.outer(unit, unit))
    information, vectors = information[::-1], vectors[:, ::-1]
    with np.errstate(divide="ignore"):
        deviation = 1.0 / np.sqrt(np.maximum(information, 0.0))
    return Directions(unit[:, None] * vectors, deviation, deviation < DETERMINED_M)


def open_axes(
    motions: np.ndarray,  # (6, q), columns as in `Directions.motions`
) -> tuple[np.ndarray, np.ndarray]:
    """Shifts and turns among some motions: unit directions (s, 3) and axes (t, 3) in B.

    Where a turn comes with a shift, as a ball's about its middle, the turn counts.
    """
    if not motions.size:
        return np.zeros((0, 3)), np.zeros((0, 3))
    # An eigenvector's turning part is 1/radius long at most: larger singular values are turns.
    vectors, sizes, mixed = np.linalg.svd(motions[3:])
    turning = sizes > _TURNS * max(float(sizes.max()), 1.0 / _LARGEST_RADIUS_M)
    turns = vectors.T[: len(sizes)][turning]
    still = motions @ mixed[int(turning.sum()) :].T
    shifts = still[:3] / np.maximum(np.linalg.norm(still[:3], axis=0), 1e-12)
    return shifts.T, turns
