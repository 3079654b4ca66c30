"""Exporter of frames to files for other programs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.membrane import MembraneMesh
from bubbleviz.pipeline import Product
from bubbleviz.result import Result


class Exporter:
    """Takes the results of frames one after the other and writes files."""

    products: frozenset[Product] = frozenset()  # what each result must hold; no more is computed

    def add(self, result: Result) -> None:
        """Take the next frame."""
        raise NotImplementedError

    def finish(self) -> None:
        """Write what needs all frames."""


@dataclass(frozen=True)
class Shape:
    """Deformed membrane with its nodal fields."""

    # (n, 3), x0 + u n0 (Eq. 1) in B; the reference surface for a frame about which nothing is known
    points_m: np.ndarray
    # displacement_m, contact_pressure_pa: (n,), NaN for such a frame
    displacement_m: np.ndarray
    contact_pressure_pa: np.ndarray

    @classmethod
    def of(cls, mesh: MembraneMesh, result: Result) -> Shape:
        estimate = result.trusted_estimate
        if estimate is None:
            nothing = np.full(len(mesh.nodes), np.nan)
            return cls(mesh.nodes, nothing, nothing)
        points = mesh.deformed(estimate.motion_m)
        return cls(points, estimate.displacement_m, estimate.contact_pressure_pa)
