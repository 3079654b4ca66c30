"""From a depth image to displacement, contact pressure and gas pressure."""

from __future__ import annotations

import time

import numpy as np

from bubbleviz.camera.observer import Linearisation, Observation, RangeObserver
from bubbleviz.inverse.normal import NormalEquations
from bubbleviz.inverse.osqp_solver import OsqpSolver
from bubbleviz.inverse.problem import Equilibrium, FrameProblem, kkt_residual
from bubbleviz.inverse.scales import Scales
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Estimate


class Estimator:
    """Solves the inverse problem frame by frame, warm-started.

    Parameters
    ----------
    observer : RangeObserver
    gas : Gas
    tension_n_per_m : float
        γ0, N/m.
    gauge_pressure_pa : float
    """

    def __init__(
        self,
        observer: RangeObserver,
        gas: Gas,
        tension_n_per_m: float,
        gauge_pressure_pa: float,
    ) -> None:
        self.mesh: MembraneMesh = observer.mesh
        self.observer = observer
        self.gas = gas
        self.scales = Scales.of(self.mesh, tension_n_per_m)
        self._equilibrium = Equilibrium(self.mesh, gas, self.scales)
        self._normal = NormalEquations(self.mesh)
        self._solver = OsqpSolver(self._equilibrium)
        # Prior: a jump of the gauge pressure across one mesh edge is one standard deviation.
        self._lambda = (self.scales.pressure_pa / gauge_pressure_pa) ** 2

    def estimate(self, depth_m: np.ndarray, gas_pressure_pa: float | None = None) -> Estimate:
        """Solve one frame.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth, NaN where there is no return.
        gas_pressure_pa : float, optional
            Measured absolute gas pressure.
        """
        a, p = self.scales.length_m, self.scales.pressure_pa
        observation = self.observer.observe(depth_m)
        linear = self.observer.linearise()
        Q, g = self._normal.assemble(observation, linear)
        gas = None if gas_pressure_pa is None else (gas_pressure_pa - self.gas.P0) / p
        problem = FrameProblem(Q * a**2, g * a, self._lambda, np.zeros(len(g)), gas)
        start = time.perf_counter()
        solution = self._solver.solve(problem)
        elapsed = 1e3 * (time.perf_counter() - start)
        u, pressure = np.zeros(len(self.mesh.nodes)), np.zeros(len(self.mesh.nodes))
        u[self.mesh.free] = a * solution.displacement
        pressure[self.mesh.free] = p * solution.pressure
        return Estimate(
            status="ok" if solution.converged else "not_converged",
            displacement_m=u,
            contact_pressure_pa=pressure,
            gas_pressure_change_pa=p * solution.gas,
            residual_rms_m=self._misfit(observation, linear, u),
            kkt_residual=kkt_residual(self._equilibrium, problem, solution.pressure),
            iterations=solution.iterations,
            solve_ms=elapsed,
        )

    def _misfit(self, observation: Observation, linear: Linearisation, u: np.ndarray) -> float:
        hits = linear.hits
        model = linear.offset_m + np.einsum(
            "ij,ij->i", hits.sensitivity, u[self.mesh.triangles[hits.triangle]]
        )
        weight = observation.weight[hits.ray]
        error = observation.residual_m[hits.ray] - model
        return float(np.sqrt(np.sum(weight * error**2) / max(np.sum(weight), 1e-300)))
