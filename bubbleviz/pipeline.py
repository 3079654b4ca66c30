"""Which products a consumer asks for decides which stages run."""

from __future__ import annotations

from collections import Counter
from typing import Literal

from bubbleviz.frames.frame import Frame
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.sensor import Sensor

Product = Literal["estimate", "patch", "pixel_mask", "cloud", "residual"]


class Pipeline:
    """Frame in, the products asked for out.

    Parameters
    ----------
    sensor : Sensor
    kappa : float, optional
        Patch threshold as a multiple of the mean contact pressure (V-C); None for the default.
    solver : str
        Name of an inverse solver.

    Attributes
    ----------
    mesh : MembraneMesh
        Reference surface.
    counts : Counter
        How often each stage ran, by stage name.
    """

    def __init__(self, sensor: Sensor, *, kappa: float | None = None, solver: str = "osqp") -> None:
        self.sensor = sensor
        self.kappa = kappa
        self.mesh: MembraneMesh
        self.counts: Counter[str] = Counter()

    def process(self, frame: Frame, products: frozenset[Product]) -> Result:
        """Run the stages that `products` need on one frame."""
        raise InputError

    def patch(self, estimate: Estimate) -> Patch:
        """Patch of an estimate at the present κ, without solving again."""
        raise InputError
