"""Checks of an estimate that share no code with the solver that made it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bubbleviz.inverse.rubber_estimator import RubberEstimator
from bubbleviz.membrane.forward_model import Contact
from bubbleviz.membrane.stiffness import cotangent_laplacian
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.simulation.truth import Truth

BALANCE = 1e-3  # largest residual of membrane balance and gas law over their largest term
KKT = {"paper": 5e-2}  # largest, of a solver that stops early; 1e-3 of others
FORCE_RELATIVE = 0.2  # of the true force; chosen as a gross error
FORCE_PER_EDGE = 20.0  # relative error per m of mesh edge: coarse meshes are worse
FORCE_PER_NOISE = 2.5  # of γ0 × noise: the force that noise alone makes
RUBBER_BALANCE = 1e-2
"""Largest force that the exact membrane's equilibrium misses along a random motion, relative to
that of the gas: ten times what a node may be off by."""
RUBBER_RELATIVE, RUBBER_PER_EDGE = 0.05, 10.0
"""Force error of the exact membrane that its sigma does not know of: that of its mesh, relative,
and per m of mesh edge where that is more."""
SIGMAS = 4.0  # seldom exceeded by chance in some dozens of cases
MISFIT = 3.0  # largest of a frame that is called ok, in units of the noise


@dataclass(frozen=True)
class Band:
    """How far the force may be off.

    Where the estimate gives a sigma: four of it, and what the mesh makes wrong. Elsewhere a fifth
    of the force, or 2 % for every millimetre of mesh edge where that is more, plus γ0 times 2.5 σ
    of the range: a membrane that moves by σ changes its force by about γ0 σ, whatever its size.
    """

    noise_m: float  # σ of range in the frame; at least 0.3 mm is granted for the mesh

    def width_n(self, truth: Truth, pipeline: Pipeline, estimate: Estimate) -> float:
        """Width of the band on either side of the true force, N."""
        true = float(np.linalg.norm(truth.force_n))
        edge = 1.5 * np.sqrt(np.median(pipeline.mesh.facet_areas))
        if estimate.status == "ok" and estimate.force_sigma_n is not None:
            sigma = float(np.linalg.norm(estimate.force_sigma_n))
            return SIGMAS * sigma + max(RUBBER_RELATIVE, RUBBER_PER_EDGE * edge) * true
        floor = FORCE_PER_NOISE * pipeline.model.tension_n_per_m * max(self.noise_m, 3e-4)
        relative = max(FORCE_RELATIVE, FORCE_PER_EDGE * edge)
        return float(relative * true + floor)


def forward_faults(contact: Contact, gauge_pressure_pa: float) -> list[str]:
    """Faults of a forward solution, by its residuals."""
    pressure = max(gauge_pressure_pa, float(np.max(contact.contact_pressure_pa)))
    checks = {
        "not finite": np.isfinite(contact.displacement_m).all(),
        "negative pressure": contact.contact_pressure_pa.min() >= 0.0,
        "balance": contact.balance_residual < 1e-6,
        "gas law": contact.gas_law_residual < 1e-6,
        "penetration": contact.penetration_m < 1e-8,
        "complementarity": contact.complementarity < 1e-8 * pressure,
        "not converged": contact.converged,
    }
    return [f"forward: {name}" for name, held in checks.items() if not held]


def inverse_faults(
    pipeline: Pipeline, result: Result, truth: Truth | None, band: Band, measured_gas: bool = False
) -> list[str]:
    """Faults of a result whose status is `ok` or `no_contact`."""
    estimate, patch = result.estimate, result.patch
    if estimate is None or patch is None:
        return ["no estimate or no patch"]
    faults = _fields(pipeline, estimate, patch, band)
    if not faults and isinstance(pipeline.estimator, RubberEstimator):
        faults = _rubber_equations(pipeline, pipeline.estimator, estimate, patch, measured_gas)
    elif not faults:
        faults = _linear_equations(pipeline, estimate, patch, measured_gas)
    if truth is None or faults:
        return faults
    off = float(np.linalg.norm(patch.force_n - truth.force_n))
    width = band.width_n(truth, pipeline, estimate)
    if off <= width:
        return []
    true, got = np.linalg.norm(truth.force_n), np.linalg.norm(patch.force_n)
    return [
        f"called {estimate.status} with {got:.4g} N instead of {true:.4g} N (band {width:.3g} N)"
    ]


def _fields(pipeline: Pipeline, estimate: Estimate, patch: Patch, band: Band) -> list[str]:
    """Finite numbers, a status that fits them, and a certificate and a misfit that fit it."""
    numbers: list[Any] = [
        *(estimate.displacement_m, estimate.contact_pressure_pa, estimate.gas_pressure_change_pa),
        *(estimate.residual_rms_m, estimate.kkt_residual, patch.force_n, patch.area_m2),
    ]
    if not all(np.isfinite(x).all() for x in numbers):
        return ["not finite"]
    if estimate.contact_pressure_pa.min() < 0.0:
        return [f"negative pressure {estimate.contact_pressure_pa.min():.3g} Pa"]
    touched = bool(np.any(estimate.contact_pressure_pa > 0.0))
    if touched != (estimate.status == "ok"):
        return [f"status {estimate.status} with{'' if touched else 'out'} contact pressure"]
    limit = KKT.get(pipeline.estimator.solver_name, 1e-3)
    if estimate.kkt_residual > limit:
        return [f"KKT residual {estimate.kkt_residual:.2g} above {limit:g}"]
    if estimate.residual_rms_m > MISFIT * max(band.noise_m, 1e-3):
        misfit = 1e3 * estimate.residual_rms_m
        return [f"called {estimate.status} with a misfit of {misfit:.2g} mm"]
    return []


def _linear_equations(
    pipeline: Pipeline, estimate: Estimate, patch: Patch, measured_gas: bool
) -> list[str]:
    """Rim, force, balance K u = A (p_v − p_c) and the linearised gas law p_v = −βᵀu, afresh."""
    mesh, faults = pipeline.mesh, []
    u, p_v = estimate.displacement_m, estimate.gas_pressure_change_pa
    if np.any(u[mesh.rim] != 0.0):
        faults.append("the rim moves")
    force = -(mesh.areas * estimate.contact_pressure_pa) @ mesh.normals
    if not np.allclose(force, patch.force_n, rtol=1e-6, atol=1e-12):
        faults.append("the force is not that of the pressure")
    elastic = pipeline.model.tension_n_per_m * (cotangent_laplacian(mesh) @ u)[mesh.free]
    gas = p_v * mesh.areas[mesh.free]
    contact = (mesh.areas * estimate.contact_pressure_pa)[mesh.free]
    largest = max(float(np.abs(x).max(initial=0.0)) for x in (elastic, gas, contact))
    off = float(np.abs(elastic - gas + contact).max(initial=0.0))
    if off > BALANCE * max(largest, 1e-300):
        faults.append(f"balance off by {off / largest:.2g} of its largest term")
    if not measured_gas:
        beta = pipeline.model.gas.beta
        law, size = -float(beta @ u), float(np.abs(beta) @ np.abs(u))
        if abs(law - p_v) > BALANCE * max(size, 1e-9):
            faults.append(f"gas law: p_v {p_v:.4g} Pa instead of {law:.4g} Pa")
    return faults


def _rubber_equations(
    pipeline: Pipeline,
    estimator: RubberEstimator,
    estimate: Estimate,
    patch: Patch,
    measured_gas: bool,
) -> list[str]:
    """Equilibrium, gas law and force, by differences of the membrane's energy and volume alone."""
    membrane = estimator.membrane
    friction, unexplained = estimate.friction_n, estimate.unexplained_pressure_pa
    if estimate.displacement_3d_m is None or friction is None or unexplained is None:
        return []
    rest, gas, gauge = pipeline.mesh.nodes, pipeline.model.gas, membrane.gauge_pressure_pa
    x, p_v = rest + estimate.displacement_3d_m, estimate.gas_pressure_change_pa
    contact = estimate.contact_pressure_pa / gauge
    inside = 1.0 + p_v / gauge - contact - unexplained / gauge
    moving = np.isin(np.arange(len(rest)), membrane.moving)[:, None]
    rng, missed, loads, h = np.random.default_rng(0), [], [], 1e-7

    def slope(function: Callable[[np.ndarray], float], at: np.ndarray, way: np.ndarray) -> float:
        return (function(at + h * way) - function(at - h * way)) / (2.0 * h)

    for _ in range(8):
        way = moving * rng.standard_normal(rest.shape)
        loads.append(gauge * slope(membrane.volume, rest, way))
        held = slope(membrane.energy, rest, way) - loads[-1]
        pushed = gauge * slope(membrane.volume, x, inside[:, None] * way)
        missed.append(slope(membrane.energy, x, way) - pushed - np.vdot(friction, way) - held)
    faults = []
    off, load = np.linalg.norm(missed), np.linalg.norm(loads)
    if off > RUBBER_BALANCE * load:
        faults.append(f"balance off by {off / load:.2g} of the gas load")
    force = [-gauge * slope(membrane.volume, x, contact[:, None] * axis) for axis in np.eye(3)]
    whole = force + friction.sum(axis=0)
    told = np.array([patch.force_n, estimate.force_n])
    if not np.allclose(told, whole, rtol=1e-4, atol=1e-5):
        faults.append("the force is not that of pressure and friction")
    if not measured_gas:
        grown = membrane.volume(x) - membrane.volume(rest)
        law = -gas.P0 * grown / (gas.V0 + grown)
        if abs(law - p_v) > BALANCE * max(abs(law), 1.0):
            faults.append(f"gas law: p_v {p_v:.4g} Pa instead of {law:.4g} Pa")
    return faults
