"""Where the solution of one frame is, and what it leaves unexplained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse

from bubbleviz.camera.observer import Observation, ShapeRanges
from bubbleviz.inverse.linearised_rubber import LinearisedRubber
from bubbleviz.shear.flow_observer import MeasuredFlow, ShapeFlow
from bubbleviz.shear.traction_problem import Measurements


@dataclass(frozen=True)
class TractionStart:
    """Where one frame ended and the next may begin.

    Attributes
    ----------
    x : (n, 3) array
        Shape, m.
    pressure : (n,) array
        p_c, Pa.
    shear : (n, 3) array
        Forces along the membrane, N.
    gas : float
        p_v, Pa.
    rubber : LinearisedRubber
        Tangent that was used last.
    range_noise, flow_noise : float
        By how much more than their noise ranges and flow were missed.
    view : ShapeRanges or None
        The depth camera's model at the last shape that was looked at, which the next is close to.
    """

    x: np.ndarray
    pressure: np.ndarray
    shear: np.ndarray
    gas: float
    rubber: LinearisedRubber
    range_noise: float = 1.0
    flow_noise: float = 1.0
    view: ShapeRanges | None = None


class Look(NamedTuple):
    """What a shape leaves unexplained, and how that changes with the shape.

    Attributes
    ----------
    view : ShapeRanges
    observation : Observation
        Of the ranges.
    range_error : (k,) array
        Measured less modelled, of the blocks of `view`, m.
    flow : ShapeFlow
    flow_error : (j, 2) array
        Measured less modelled, pixels.
    measured : MeasuredFlow
    """

    view: ShapeRanges
    observation: Observation
    range_error: np.ndarray
    flow: ShapeFlow
    flow_error: np.ndarray
    measured: MeasuredFlow

    def measurements(self, state: TractionStart) -> Measurements:
        """Both, each trusted as far as the state's noise says."""
        by_flow = np.repeat(1.0 / (state.flow_noise * self.measured.sigma_px) ** 2, 2)
        by_range = self.observation.weight[self.view.block] / state.range_noise**2
        return Measurements(
            sparse.vstack([self.view.jacobian, self.flow.jacobian], format="csr"),
            np.concatenate([self.range_error, self.flow_error.ravel()]),
            np.concatenate([by_range, by_flow]),
        )

    def misfit(self, state: TractionStart) -> float:
        """Mean square error in standard deviations, by the noise of a state."""
        by_range = self.observation.weight[self.view.block] / state.range_noise**2
        by_flow = 1.0 / (state.flow_noise * self.measured.sigma_px) ** 2
        flow = float(by_flow @ (self.flow_error**2).sum(axis=1)) / (2 * len(by_flow))
        return float(by_range @ self.range_error**2) / len(by_range) + flow

    def after(self, motion: np.ndarray) -> Look:
        """The same after a small motion (n, 3), to first order."""
        flow = (self.flow.jacobian @ motion.ravel()).reshape(-1, 2)
        return self._replace(
            range_error=self.range_error - self.view.jacobian @ motion.ravel(),
            flow_error=self.flow_error - flow,
        )
