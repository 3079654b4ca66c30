"""From a depth image to displacement, contact pressure and gas pressure."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from bubbleviz.camera.observer import Linearisation, Observation, RangeObserver
from bubbleviz.inverse.normal import NormalEquations
from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Solution
from bubbleviz.inverse.scales import Scales
from bubbleviz.inverse.solver import make_solver
from bubbleviz.membrane.gas import Gas
from bubbleviz.result import Estimate, Status

PRESSURE_SCALE = 3.0
"""Contact pressure in gauge pressures that the prior expects: P (1 + R/r) on an object with a
radius of curvature r half that of the bubble, R (Young–Laplace on both sides)."""


@dataclass(frozen=True)
class EstimatorOptions:
    """Choices that a study varies and an operator may.

    Attributes
    ----------
    solver : str or None
        Name of the solver; None for the fastest that suits the mesh.
    relinearisations : int
        How often rays may be re-cast at the current shape within one frame.
    """

    solver: str | None = None
    relinearisations: int = 2


class Estimator:
    """Solves the inverse problem frame by frame, each started from the last.

    A first solve with an L1 term finds where there is contact, a second one on that support alone
    takes the bias of the L1 term out again.

    Parameters
    ----------
    observer : RangeObserver
    gas : Gas
    tension_n_per_m : float
        γ0, N/m.
    gauge_pressure_pa : float
    options : EstimatorOptions
    """

    MINIMUM_BLOCKS = 3
    """A plane's worth of blocks: with fewer no dent can be told from a shift of the sensor."""

    def __init__(
        self,
        observer: RangeObserver,
        gas: Gas,
        tension_n_per_m: float,
        gauge_pressure_pa: float,
        options: EstimatorOptions = EstimatorOptions(),
    ) -> None:
        self.mesh = observer.mesh
        self.observer = observer
        self.gas = gas
        self.options = options
        self.scales = Scales.of(self.mesh, tension_n_per_m)
        self._equilibrium = Equilibrium(self.mesh, gas, self.scales)
        self._normal = NormalEquations(self.mesh)
        at_rest = observer.observe_everything()
        Q, _ = self._normal.assemble(at_rest, observer.linearise())
        reference_Q = Q * self.scales.length_m**2
        self._solver = make_solver(options.solver, self._equilibrium, reference_Q)
        self._weight = float(reference_Q.diagonal().sum())
        # Moved by less than half an edge, a ray meets much the same facet at much the same slope.
        self._step_m = 0.5 * self.mesh.edge_length
        self._lambda = (self.scales.pressure_pa / (PRESSURE_SCALE * gauge_pressure_pa)) ** 2
        self._tau = detection_threshold(self._equilibrium, reference_Q)
        self._last: Solution | None = None

    def estimate(self, depth_m: np.ndarray, gas_pressure_pa: float | None = None) -> Estimate:
        """Solve one frame.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth, NaN where there is no return.
        gas_pressure_pa : float, optional
            Measured absolute gas pressure.
        """
        gas = None
        if gas_pressure_pa is not None:
            gas = (gas_pressure_pa - self.gas.P0) / self.scales.pressure_pa
        start = time.perf_counter()
        observation, linear, solution = self._solve(depth_m, gas)
        elapsed = 1e3 * (time.perf_counter() - start)
        if solution is None:
            self._last = None
            return self._untouched("no_data", np.nan, np.nan)
        self._last = solution if solution.pressure.any() else None
        return self._report(observation, linear, solution, elapsed)

    def _solve(
        self, depth_m: np.ndarray, gas: float | None
    ) -> tuple[Observation, Linearisation, Solution | None]:
        """Linearise where the last frame ended, and again where this one does."""
        around = np.zeros(len(self.mesh.nodes))
        if self._last is not None and self.options.relinearisations > 0:
            around = self._displacement_m(self._last)
        solution = self._last
        for _ in range(1 + self.options.relinearisations):
            linear = self.observer.linearise(around)
            observation = self.observer.observe(depth_m, linear.here_m)
            if np.count_nonzero(observation.weight) < self.MINIMUM_BLOCKS:
                return observation, linear, None
            solution = self._solve_linear(observation, linear, gas, solution)
            displacement = self._displacement_m(solution)
            moved = np.max(np.abs(displacement - around))
            around = displacement
            if moved <= self._step_m:
                break
        return observation, linear, solution

    def _solve_linear(
        self,
        observation: Observation,
        linear: Linearisation,
        gas: float | None,
        start: Solution | None,
    ) -> Solution:
        a, eq = self.scales.length_m, self._equilibrium
        Q, g = self._normal.assemble(observation, linear)
        Q, g = Q * a**2, g * a
        tau = self._tau * np.sqrt(Q.diagonal().sum() / self._weight)
        everywhere = np.ones(len(g), bool)
        at_zero = eq.gradient_at_zero(Q, g, gas)
        problem = FrameProblem(Q, g, self._lambda, tau, at_zero, everywhere, gas)
        nothing = np.zeros(len(g))
        if np.all(at_zero + tau >= 0.0):
            # The KKT conditions hold at p_c = 0: no contact, and no QP to solve.
            displacement, p_v = eq.displacement(nothing, gas)
            return Solution(displacement, nothing, p_v, nothing, 0, True, 0.0)
        return self._solver.solve(problem, nothing if start is None else start.shrunk)

    def _displacement_m(self, solution: Solution) -> np.ndarray:
        return self._on_nodes(self.scales.length_m * solution.displacement)

    def _on_nodes(self, values: np.ndarray) -> np.ndarray:
        field = np.zeros(len(self.mesh.nodes))
        field[self.mesh.free] = values
        return field

    def _report(
        self,
        observation: Observation,
        linear: Linearisation,
        solution: Solution,
        elapsed_ms: float,
    ) -> Estimate:
        status: Status = "ok" if solution.pressure.any() else "no_contact"
        displacement = self._displacement_m(solution)
        return Estimate(
            status=status if solution.converged else "not_converged",
            displacement_m=displacement,
            contact_pressure_pa=self._on_nodes(self.scales.pressure_pa * solution.pressure),
            gas_pressure_change_pa=self.scales.pressure_pa * solution.gas,
            residual_rms_m=self.observer.misfit_m(observation, linear, displacement),
            kkt_residual=solution.kkt_residual,
            iterations=solution.iterations,
            solve_ms=elapsed_ms,
        )

    def _untouched(self, status: Status, gas_pressure_change_pa: float, misfit: float) -> Estimate:
        zero = np.zeros(len(self.mesh.nodes))
        return Estimate(status, zero, zero, gas_pressure_change_pa, misfit, 0.0)


def detection_threshold(equilibrium: Equilibrium, Q: sparse.csr_array) -> np.ndarray:
    """L1 weights τ (n,) that noise alone exceeds at no node: √(2 ln n) of its own σ.

    Under noise the gradient at p_c = 0 is Mᵀ Dᵀ W ε with covariance MᵀQM; the factor is the
    universal threshold of Donoho and Johnstone (1994) for n values. The same penalty per newton
    holds everywhere, that of the best-seen node, so that unseen parts attract no pressure.
    """
    M = equilibrium.compliance(gas_measured=False)
    sigma = np.sqrt(np.einsum("ij,ij->j", M, Q @ M))
    return np.sqrt(2.0 * np.log(len(sigma))) * np.max(sigma / equilibrium.A) * equilibrium.A
