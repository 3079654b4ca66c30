"""Eq. 23 as the paper has it: one sparse QP in u, p_c and p_v, solved by OSQP without warm start.

    min  ½ ‖e − D u‖²_W + ½ λ p_cᵀ L p_c + τᵀ p_c
    s.t. L u = A∘(p_v − p_c),   p_v = −βᵀu or measured,   p_c ≥ 0

D is linearised once, at the reference surface. The H1 and L1 terms are those of `Estimator`: the
paper has none, and its exact minimiser on noisy depth is a set of spikes. Lengths are in units of
the membrane's size a and pressures in γ0/a.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy import sparse

from bubbleviz.camera import ImageErrors, MeasuredFlow, RangeObserver
from bubbleviz.inverse.contact_problem import ContactProblem, Prior
from bubbleviz.inverse.estimator import PAPER, Estimator, EstimatorOptions, no_estimate
from bubbleviz.inverse.iteration import MINIMUM_BLOCKS, Start
from bubbleviz.inverse.measurements import Measurements, Nuisances
from bubbleviz.inverse.plausibility import STATUS_REASONS, reason_against_fit, reason_against_gas
from bubbleviz.inverse.response import ConstantTension
from bubbleviz.membrane import cotangent_laplacian, parts_with
from bubbleviz.result import Estimate

_TOLERANCE = 1e-5  # of a problem whose numbers are of order one; chosen
MOST_ITERATIONS = 10_000


class PaperEstimator(Estimator):
    """The paper's estimator as a baseline: sets up, factorises and solves every frame anew.

    Parameters
    ----------
    observer : RangeObserver
    bubble : ConstantTension
    options : EstimatorOptions, optional
    """

    def __init__(
        self,
        observer: RangeObserver,
        bubble: ConstantTension,
        options: EstimatorOptions | None = None,
    ) -> None:
        super().__init__(observer, bubble, options)
        self.solver_name = PAPER
        mesh, gas = self.mesh, bubble.gas
        self._pressure_pa = bubble.tension_n_per_m / self.size_m
        self._L = cotangent_laplacian(mesh)[mesh.free][:, mesh.free].tocsc()
        self._areas = mesh.areas[mesh.free] / self.size_m**2
        self._beta = gas.beta[mesh.free] * self.size_m / self._pressure_pa
        self._view = observer.around(mesh.nodes)
        tangent = bubble.linearised(mesh.nodes, np.zeros(len(mesh.nodes)), None)
        D = tangent.by_coordinates(self._view.jacobian)  # by displacement along the normals
        self._D = (self.size_m * D)[:, mesh.free]

    def estimate(
        self,
        depth_m: np.ndarray,
        gas_pressure_pa: float | None = None,
        start: Start | None = None,
        gas_sigma_pa: float = 0.0,
        flow: MeasuredFlow | None = None,
        image_errors: ImageErrors | None = None,
        noise: float = 1.0,
    ) -> tuple[Estimate, Start]:
        """Solve one frame by depth, and by gas pressure if its zero is known."""
        mesh, behind = self.mesh, self.bubble.gas
        gas = None if gas_sigma_pa else behind.measured_change(gas_pressure_pa)
        if gas is not None and (beyond := reason_against_gas(gas, behind)):
            return no_estimate(mesh, "implausible", beyond), Start()
        observation = self.observer.observe(depth_m)
        error, weight = (v[self._view.block] for v in (observation.residual_m, observation.weight))
        if np.count_nonzero(weight) < MINIMUM_BLOCKS:
            return no_estimate(mesh, "no_data", STATUS_REASONS["no_data"]), Start()
        ranges = Measurements(self._view.jacobian, error, weight, Nuisances.none(len(mesh.nodes)))
        problem, prior = self._problem(ranges, gas)
        began = time.perf_counter()
        pressure, iterations, converged = self._contact_pressure(problem, ranges, gas, prior)
        solve_ms = 1e3 * (time.perf_counter() - began)
        motion, balanced = self._moved(pressure, gas)
        if not (converged and balanced):
            reason = STATUS_REASONS["not_converged"]
            return no_estimate(mesh, "not_converged", reason), Start()
        residual = observation, self._view.block, error - self._view.jacobian @ motion.ravel()
        misfit = self.observer.misfit(*residual, self.observer.noise_factor(*residual))
        if doubt := reason_against_fit(misfit, self.observer.white, self.size_m):
            return no_estimate(mesh, "implausible", doubt, misfit.rms_m), Start()
        law = self.bubble.gas_at(mesh.nodes + motion)[0]
        force = -pressure[:, None] * self.bubble.area_vectors(mesh.nodes)
        estimate = Estimate(
            status="ok" if pressure.any() else "no_contact",
            displacement_m=np.einsum("ij,ij->i", motion, mesh.normals),
            contact_pressure_pa=pressure,
            gas_pressure_change_pa=law if gas is None else gas,
            residual_rms_m=misfit.rms_m,
            kkt_residual=problem.kkt_residual(pressure),
            iterations=iterations,
            solve_ms=solve_ms,
            displacement_3d_m=motion,
            nodal_force_n=force,
            force_n=force.sum(axis=0),
            gas_law_pa=law,
            caveat=self.bubble.caveat,
        )
        return estimate, Start()

    def _contact_pressure(
        self, problem: ContactProblem, ranges: Measurements, gas: float | None, prior: Prior
    ) -> tuple[np.ndarray, int, bool]:
        """Contact pressure (n,), Pa; iterations; whether it converged."""
        mesh, none, threshold = self.mesh, np.zeros(len(self.mesh.nodes)), prior.threshold
        if problem.zero_is_optimal():
            return none, 0, True
        found, iterations, converged = self._solved(ranges, gas, threshold, ~mesh.rim)
        slope = (problem.gradient(found) + threshold) / mesh.areas
        # A first-order iterate is nowhere exactly zero: the support has the nodes whose scaled
        # pressure exceeds their multiplier.
        scale = found.max(initial=0.0) / max(float(np.abs(slope).max()), 1e-300)
        support = found > np.maximum(slope, 0.0) * scale
        least = self.held_pressure_pa + (gas or 0.0)
        while converged and support.any():
            pressure, more, converged = self._solved(ranges, gas, none, support)
            iterations += more
            support = parts_with(mesh.rings, pressure >= least, pressure > 0.0)
            if np.array_equal(support, pressure > 0.0):
                return pressure, iterations, converged
        return none, iterations, converged

    def _moved(self, pressure: np.ndarray, gas: float | None) -> tuple[np.ndarray, bool]:
        """Motion (n, 3) under a contact pressure, with the exact gas law; whether it converged."""
        nodes = self.mesh.nodes
        tangent = self.bubble.linearised(nodes, pressure, gas)
        motion = tangent.motion(((gas or 0.0) - pressure)[:, None] * tangent.area_vectors)
        x, balanced, _ = self.bubble.equilibrium(tangent, nodes + motion, pressure, gas)
        return x - nodes, balanced

    def _problem(self, ranges: Measurements, gas: float | None) -> tuple[ContactProblem, Prior]:
        """The problem in p_c alone (Eq. 24), for its gradient."""
        mesh, nothing = self.mesh, np.zeros(len(self.mesh.nodes))
        tangent = self.bubble.linearised(mesh.nodes, nothing, gas)
        prior = Prior(self.smoothness, self._newton.threshold(ranges), mesh.rings)
        return ContactProblem(tangent, ranges, prior, nothing, (gas or 0.0) * tangent.bulge), prior

    def _solved(
        self, ranges: Measurements, gas: float | None, threshold: np.ndarray, allowed: np.ndarray
    ) -> tuple[np.ndarray, int, bool]:
        """Contact pressure (n,) on the allowed nodes, Pa; iterations; whether it converged."""
        import osqp  # only where it is the chosen solver

        n, k = len(self._areas), np.flatnonzero(allowed[self.mesh.free])
        nodes = self.mesh.free[k]
        Q = self._D.T @ (sparse.diags_array(ranges.weight) @ self._D)
        scale = 1.0 / max(Q.diagonal().mean(), 1e-12)
        H1 = self._pressure_pa**2 * self.smoothness[nodes][:, nodes]
        hessian = sparse.block_diag((Q, H1, sparse.csc_array((1, 1))))
        pull = self._D.T @ (ranges.weight * ranges.error)
        linear = np.concatenate([-pull, self._pressure_pa * threshold[nodes], [0.0]])
        rows: Any = [
            [
                self._L,
                sparse.diags_array(self._areas).tocsc()[:, k],
                -sparse.csc_array(self._areas[:, None]),
            ],
            [sparse.csc_array(self._beta[None, :]), None, sparse.csc_array([[1.0]])],
            [None, sparse.eye_array(len(k)), None],
            [None, None, sparse.csc_array([[1.0]])],
        ]
        # An infinite pair of bounds switches a row off: gas law, or measured p_v.
        none, zero, least = (-np.inf, np.inf), np.zeros(n), np.zeros(len(k))
        law, known = ((0.0, 0.0), none) if gas is None else (none, 2 * (gas / self._pressure_pa,))
        solver: Any = osqp.OSQP()
        solver.setup(
            _for_osqp(sparse.triu(hessian) * scale),
            linear * scale,
            _for_osqp(sparse.block_array(rows)),
            np.concatenate([zero, [law[0]], least, [known[0]]]),
            np.concatenate([zero, [law[1]], least + np.inf, [known[1]]]),
            eps_abs=_TOLERANCE,
            eps_rel=_TOLERANCE,
            max_iter=MOST_ITERATIONS,
            verbose=False,
            polishing=False,
        )
        result = solver.solve(raise_error=False)
        pressure = np.zeros(len(allowed))
        pressure[nodes] = self._pressure_pa * np.maximum(result.x[n : n + len(k)], 0.0)
        return pressure, result.info.iter, result.info.status_val == 1


def _for_osqp(matrix: sparse.sparray) -> sparse.csc_matrix:
    """OSQP accepts only a `csc_matrix` with 32-bit indices."""
    csc = sparse.csc_matrix(matrix)
    csc.sort_indices()
    csc.indices, csc.indptr = csc.indices.astype(np.int32), csc.indptr.astype(np.int32)
    return csc
