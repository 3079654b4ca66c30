"""Base class of exporters to files for other programs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from bubbleviz.membrane import MembraneMesh
from bubbleviz.pipeline import Product
from bubbleviz.result import Result


class Exporter(ABC):
    """Receives the results of frames in order and writes files."""

    products: frozenset[Product] = frozenset()  # required in each result

    @abstractmethod
    def add(self, result: Result) -> None:
        """Write what concerns the frame alone."""

    def finish(self) -> None:  # noqa: B027 - many have none
        """Write the files that depend on all frames."""


@dataclass(frozen=True)
class Shape:
    """Deformed membrane with its nodal fields."""

    # (n, 3), x0 + u n0 (Eq. 1) in B; the reference surface in a frame without trusted estimate
    points_m: np.ndarray
    # displacement_m, contact_pressure_pa: (n,), NaN in such a frame
    displacement_m: np.ndarray
    contact_pressure_pa: np.ndarray

    @classmethod
    def of(cls, mesh: MembraneMesh, result: Result) -> Shape:
        estimate = result.trusted_estimate
        if estimate is None:
            unknown = np.full(len(mesh.nodes), np.nan)
            return cls(mesh.nodes, unknown, unknown)
        points = mesh.deformed(estimate.motion_m)
        return cls(points, estimate.displacement_m, estimate.contact_pressure_pa)
