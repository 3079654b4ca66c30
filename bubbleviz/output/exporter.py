"""Interface of the exporters, and the membrane of one frame as files hold it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bubbleviz.membrane import MembraneMesh
from bubbleviz.output.results import UNKNOWN
from bubbleviz.pipeline import Product
from bubbleviz.result import Estimate, Result


class Exporter(Protocol):
    """Takes the results of frames one after the other and writes files.

    Attributes
    ----------
    products : frozenset of Product
        What each result must hold; nothing else is computed for it.
    """

    products: frozenset[Product]

    def add(self, result: Result) -> None:
        """Take the next frame."""

    def finish(self) -> None:
        """Write what needs all frames."""


def estimate_of(result: Result) -> Estimate:
    """The estimate of a result that was processed with the product `estimate`."""
    if result.estimate is None:
        raise ValueError("the product estimate was not asked for")
    return result.estimate


def is_known(estimate: Estimate) -> bool:
    """Whether the estimate has a membrane shape."""
    return estimate.status not in UNKNOWN


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
        """Shape of a result that holds an estimate."""
        estimate = estimate_of(result)
        if not is_known(estimate):
            nothing = np.full(len(mesh.nodes), np.nan)
            return cls(mesh.nodes, nothing, nothing)
        points = mesh.deformed(estimate.motion_m)
        return cls(points, estimate.displacement_m, estimate.contact_pressure_pa)
