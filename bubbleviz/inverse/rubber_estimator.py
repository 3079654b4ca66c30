"""From a depth image to shape, contact pressure and gas pressure of the exact rubber membrane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bubbleviz.camera import RangeObserver
from bubbleviz.inverse.contact_problem import smoothness
from bubbleviz.inverse.estimator import MAX_NODES, EstimatorOptions, check_size
from bubbleviz.inverse.gauss_newton import FailedFrame, GaussNewton, RubberStart, SolvedFrame
from bubbleviz.inverse.plausibility import (
    GAS_CONTRADICTS,
    STATUS_REASONS,
    reason_against_fit,
    reason_against_gas,
)
from bubbleviz.inverse.problem import Scales
from bubbleviz.inverse.resolution import at_noise, resolution_m
from bubbleviz.inverse.response import RubberEquilibrium
from bubbleviz.inverse.solvers import RUBBER
from bubbleviz.membrane import Gas, RubberMembrane
from bubbleviz.result import Estimate, Status


class RubberEstimator:
    """Solves the inverse problem of the exact membrane frame by frame, each started from the last.

    Contact presses along the current normals on the support that an L1 term finds, and drags along
    the membrane as `friction_loads` says; everywhere else the membrane is in equilibrium by
    construction. A connected part of the support that nowhere reaches the gas pressure is no
    contact: what lies on something flat or convex carries that. Nor is one without `evident` load.

    Parameters
    ----------
    observer : RangeObserver
    membrane : RubberMembrane
    gas : Gas
        P0 and V0 of the reference configuration.
    options : EstimatorOptions, optional
    variants : sequence of RubberMembrane, optional
        The membrane with one of its material numbers moved by its standard deviation each, for
        `force_sigma_n`.

    Attributes
    ----------
    solver_name : str
    held_pressure_pa : float
        Gauge pressure of the reference configuration, which a contact carries that flattens it.
    prior_weight : float
        λ of the H1 term, 1/Pa².
    smoothness : (n, n) sparse array
        λ L of the H1 term.
    resolution_m : float
        Width of the estimate's response to a point load, m, at the noise of the camera; that of a
        frame is in its estimate.
    """

    def __init__(
        self,
        observer: RangeObserver,
        membrane: RubberMembrane,
        gas: Gas,
        options: EstimatorOptions | None = None,
        variants: Sequence[RubberMembrane] = (),
    ) -> None:
        self.mesh = observer.mesh
        check_size(self.mesh, MAX_NODES)
        self.observer, self.membrane, self.gas = observer, membrane, gas
        self.options = options or EstimatorOptions()
        self.solver_name = RUBBER
        self.held_pressure_pa = membrane.gauge_pressure_pa
        self.prior_weight = (self.options.pressure_scale * self.held_pressure_pa) ** -2.0
        self.equilibrium = RubberEquilibrium(membrane, gas, variants)
        self.smoothness = smoothness(self.mesh, self.prior_weight)
        size = Scales.of(self.mesh, membrane.mean_tension).length_m
        self._newton = GaussNewton(
            observer, self.equilibrium, self.smoothness, size, self.options.friction
        )
        density = self._newton.weight_density
        self.resolution_m = resolution_m(self.prior_weight, membrane.mean_tension, density)

    def estimate(
        self,
        depth_m: np.ndarray,
        gas_pressure_pa: float | None = None,
        start: RubberStart | None = None,
        gas_sigma_pa: float = 0.0,
    ) -> tuple[Estimate, RubberStart]:
        """Solve one frame; also what the next one starts from.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth, NaN where there is no return.
        gas_pressure_pa : float, optional
            Measured absolute gas pressure.
        start : RubberStart, optional
            Of the frame before; from rest when None.
        gas_sigma_pa : float
            Standard deviation of the zero of the gas pressure, Pa.
        """
        start, newton = start or RubberStart(), self._newton
        if gas_sigma_pa:
            newton = newton.with_gas(replace(self.gas, zero_sigma_pa=gas_sigma_pa))
        gas = None
        if gas_pressure_pa is not None and not np.isnan(gas_pressure_pa):
            gas = gas_pressure_pa - self.gas.P0
            if beyond := reason_against_gas(gas, self.gas):
                return self._nothing("implausible", beyond), RubberStart()
        measured = self.observer.measure(depth_m)
        try:
            answer = newton.solve(measured, gas, start)
        except (RuntimeError, np.linalg.LinAlgError):  # a singular tangent, or Hessian
            answer = FailedFrame("not_converged")
        if isinstance(answer, FailedFrame):
            nothing = self._nothing(answer.status, STATUS_REASONS[answer.status])
            return nothing, RubberStart(reached=answer.reached, measured=measured)
        doubt = GAS_CONTRADICTS if answer.contradicts_gas else ""
        if doubt := doubt or reason_against_fit(answer.misfit, self.observer.white):
            nothing = self._nothing("implausible", doubt, answer.misfit.rms_m)
            return nothing, RubberStart(reached=answer.step.state, measured=measured)
        state, rubber = answer.step.state, answer.step.rubber
        touching = state if state.pressure.any() else None
        start = RubberStart(touching, rubber, answer.noise, state, measured, answer.view)
        return self._report(answer), start

    def _report(self, answer: SolvedFrame) -> Estimate:
        state, contact = answer.step.state, answer.step.contact
        touching, moved = bool(state.pressure.any()), state.x - self.mesh.nodes
        unexplained = np.where(answer.contact, 0.0, state.pressure)
        pressure = state.pressure - unexplained
        friction = np.where(unexplained[:, None] > 0.0, 0.0, state.friction)
        force = friction - pressure[:, None] * self.membrane.volume_gradient(state.x)
        return Estimate(
            status="ok" if touching else "no_contact",
            displacement_m=np.einsum("ij,ij->i", moved, self.mesh.normals),
            contact_pressure_pa=pressure,
            unexplained_pressure_pa=unexplained,
            gas_pressure_change_pa=state.gas,
            residual_rms_m=answer.misfit.rms_m,
            kkt_residual=contact.kkt_residual,
            iterations=contact.pivots,
            solve_ms=answer.solve_ms,
            displacement_3d_m=moved,
            nodal_force_n=force,
            friction_n=friction,
            force_n=force.sum(axis=0),
            force_sigma_n=answer.sigma_n,
            gas_law_pa=self.equilibrium.gas_at(state.x)[0],
            resolution_m=at_noise(self.resolution_m, answer.noise),
        )

    def _nothing(self, status: Status, reason: str, misfit_m: float = np.nan) -> Estimate:
        """A frame about which nothing is known."""
        zero, three = np.zeros(len(self.mesh.nodes)), np.full(3, np.nan)
        return Estimate(
            status,
            zero,
            zero,
            np.nan,
            misfit_m,
            np.nan,
            displacement_3d_m=np.zeros((len(zero), 3)),
            force_n=three,
            force_sigma_n=three,
            reason=reason,
        )
