"""From a depth image to displacement, contact pressure and gas pressure."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.camera import Linearisation, Misfit, Observation, RangeObserver, median
from bubbleviz.errors import InputError
from bubbleviz.inverse.contact_problem import FRICTION
from bubbleviz.inverse.plausibility import (
    GAS_CONTRADICTS,
    GAS_LINEAR,
    GAS_NOISE,
    STATUS_REASONS,
    contradicts_gas,
    reason_against_fit,
    reason_against_gas,
)
from bubbleviz.inverse.problem import (
    Equilibrium,
    FrameProblem,
    NormalEquations,
    Pressure,
    Scales,
    natural_residual,
)
from bubbleviz.inverse.resolution import detection_threshold, information_density, resolution_m
from bubbleviz.inverse.solvers import BASE_MESH, DROPPED, LINEAR, make_solver
from bubbleviz.membrane import Gas, MembraneMesh, mean_curvature
from bubbleviz.result import Estimate, Status

PRESSURE_SCALE = 3.0
"""Contact pressure in gauge pressures that the prior expects: P (1 + R/r) on an object with a
radius of curvature r half that of the bubble, R (Young–Laplace on both sides). The λ that follows
is compared with those of discrepancy principle and L-curve in `study accuracy --model linear`."""

RIM_SLACK_M = 1.5e-4
"""Motion of the exact membrane's rim under the pull of the mean tension, m: how precisely a clamp
holds rubber."""

MAX_NODES = 60_000
"""Of the exact membrane: beyond this a frame would take minutes."""

MAX_LINEAR_NODES = 15_000
"""Of the linear one: at 20,000 a first frame takes two minutes and does not converge."""

_NEAR, _FAR = 0.05, 0.5
"""Shares of a mesh edge. Moved by less than the first, a ray meets the same facet at the same
slope, to within what changes the patch; by more than the second, the answer is another one."""

_COLD = 3
"""Times as many casts in a first frame, which the frames of a stream share between them."""

MINIMUM_BLOCKS = 3
"""A plane's worth of blocks: with fewer, no dent can be told from a shift of the sensor."""


@dataclass(frozen=True)
class EstimatorOptions:
    """Choices that a study varies and an operator may.

    Attributes
    ----------
    solver : str or None
        `rubber` for the exact membrane, else a solver of the linear one; None for the exact one
        where the sensor's pre-stretch is known and `linear` where it is not.
    relinearisations : int
        How often rays may be re-cast at the current shape within one frame of a stream.
    nodes : int or None
        Size of the mesh of an analytic dome; None for the sensor file's.
    pressure_scale : float
        Contact pressure in gauge pressures that the prior expects, see `PRESSURE_SCALE`.
    block : int or None
        Side of the squares of pixels that are averaged; None for half a mesh edge.
    rim_slack_m : float
        How far the rim of the exact membrane gives, see `RIM_SLACK_M`.
    fine_contact : bool
        Whether the contact is solved for on a finer mesh where the mesh limits how sharp it is,
        see `contact_refiner`; never with the paper's solvers.
    friction : float
        Standard deviation of the coefficients of friction of contacts with the exact membrane, see
        `friction_loads`; 0 for contacts without friction.
    """

    solver: str | None = None
    relinearisations: int = 2
    nodes: int | None = None
    pressure_scale: float = PRESSURE_SCALE
    block: int | None = None
    rim_slack_m: float = RIM_SLACK_M
    fine_contact: bool = True
    friction: float = FRICTION

    @classmethod
    def named(cls, name: str | None, friction: float | None = None) -> EstimatorOptions:
        """Options of a `--solver` name, and of a `--friction` in place of the default.

        The name is `fast`, a solver's own, or None for the default.

        Raises
        ------
        InputError
            The name is of a solver that was dropped.
        """
        if name in DROPPED:
            raise InputError(f"solver {name}: {DROPPED[name]}")
        mu = FRICTION if friction is None else friction
        if name == "fast":
            # A coarse mesh takes larger blocks of pixels and fewer rays too.
            return cls(LINEAR, relinearisations=1, nodes=400, fine_contact=False, friction=mu)
        if name in BASE_MESH:
            return cls(BASE_MESH[name], fine_contact=False, friction=mu)
        # active-set: its name up to version 0.1
        return cls(LINEAR if name == "active-set" else name, friction=mu)


def check_size(mesh: MembraneMesh, most: int) -> None:
    """Raise InputError where a mesh has more nodes than that."""
    if len(mesh.nodes) > most:
        raise InputError(
            f"mesh: {len(mesh.nodes)} nodes are too many for the inverse problem; use at most "
            f"{most}, the noise hides what 3,000 cannot resolve"
        )


@dataclass(frozen=True)
class _Answer:
    """Where the solution of one linearised problem is.

    Attributes
    ----------
    displacement_m : (n,) array
    gas : float
    selected, pressure : (n_free,) array
        With the L1 term, and debiased; dimensionless.
    """

    displacement_m: np.ndarray
    gas: float
    selected: np.ndarray
    pressure: np.ndarray
    iterations: int
    status: Status
    kkt_residual: float
    contradicts_gas: bool = False
    solve_ms: float = 0.0


@dataclass(frozen=True)
class _LocalModel:
    """Linearised ranges, and where the linearisation holds.

    Attributes
    ----------
    linear : Linearisation
    cast_at_m : (n,) array
        Displacement at which all rays were cast.
    linear_at_m : (n,) array
        Displacement of each node when the rays around it were cast last.
    """

    linear: Linearisation
    cast_at_m: np.ndarray
    linear_at_m: np.ndarray


@dataclass(frozen=True)
class WarmStart:
    """What `Estimator.estimate` hands from one frame to the next.

    Attributes
    ----------
    model : _LocalModel
    answer : _Answer or None
        None: the frame had no contact, or nothing is known of it.
    """

    model: _LocalModel
    answer: _Answer | None = None


class Estimator:
    """Solves the inverse problem of a frame, started where the last one ended.

    A first solve with an L1 term finds where there is contact, a second one on that support alone
    takes the bias of the L1 term out again. A pressure that nowhere reaches what the membrane's
    tension holds is no contact: on something flat or convex the membrane bulges no more, so that
    the contact carries at least that (Young–Laplace).

    Parameters
    ----------
    observer : RangeObserver
    gas : Gas
    tension_n_per_m : float
        γ0, N/m.
    options : EstimatorOptions, optional

    Attributes
    ----------
    solver_name : str
    held_pressure_pa : float
        γ0 (κ1 + κ2): what the tension holds, and so what a contact carries that flattens it.
    prior_weight : float
        λ of the H1 term, 1/Pa².
    resolution_m : float
        Width of the estimate's response to a point load, m.
    """

    def __init__(
        self,
        observer: RangeObserver,
        gas: Gas,
        tension_n_per_m: float,
        options: EstimatorOptions | None = None,
    ) -> None:
        self.mesh = observer.mesh
        check_size(self.mesh, MAX_LINEAR_NODES)
        self.observer = observer
        self.gas = gas
        self.options = options or EstimatorOptions()
        self.scales = Scales.of(self.mesh, tension_n_per_m)
        self.held_pressure_pa = tension_n_per_m * mean_curvature(self.mesh)
        self._held = self.held_pressure_pa / self.scales.pressure_pa
        self._equilibrium = Equilibrium(self.mesh, gas, self.scales)
        self._normal = NormalEquations(self.mesh)
        Q, _ = self._normal.assemble(observer.observe_everything(), observer.linearise())
        reference_Q = Q * self.scales.length_m**2
        self.solver_name = self.options.solver or LINEAR
        expected = self.options.pressure_scale
        self.prior_weight = (expected * self.held_pressure_pa) ** -2.0
        self._lambda = 1.0 / (expected * self._held) ** 2
        self._solver = make_solver(self.solver_name, self._equilibrium, reference_Q, self._lambda)
        self._gas_limit = GAS_LINEAR * gas.P0 / self.scales.pressure_pa
        self._weight = float(reference_Q.diagonal().sum())
        self._tau = detection_threshold(self._equilibrium, reference_Q)
        pull = reference_Q @ self._equilibrium.bulge
        self._gas_noise = GAS_NOISE * gas.P0 / self.scales.pressure_pa
        self._gas_tau = 3.0 * self._gas_noise * self._equilibrium.adjoint(pull, gas_measured=True)
        self.resolution_m = resolution_m(
            self.prior_weight,
            tension_n_per_m,
            information_density(Q, self.mesh.areas[self.mesh.free]),
        )
        self._near_m, self._far_m = (k * self.mesh.edge_length for k in (_NEAR, _FAR))
        rest = np.zeros(len(self.mesh.nodes))
        self._cold = WarmStart(_LocalModel(observer.linearise(), rest, rest))

    def estimate(
        self,
        depth_m: np.ndarray,
        gas_pressure_pa: float | None = None,
        start: WarmStart | None = None,
        gas_sigma_pa: float = 0.0,
    ) -> tuple[Estimate, WarmStart]:
        """Solve one frame; also what the next one starts from.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth, NaN where there is no return.
        gas_pressure_pa : float, optional
            Measured absolute gas pressure.
        start : WarmStart, optional
            Of the frame before; from rest when None.
        gas_sigma_pa : float
            Standard deviation of the zero of the gas pressure, Pa. Where it is not 0 the pressure
            is left alone and follows from the volume: here a measured one has no error.
        """
        start = start or self._cold
        gas = None
        measured = gas_pressure_pa is not None and not np.isnan(gas_pressure_pa)
        if gas_pressure_pa is not None and measured and not gas_sigma_pa:
            change = gas_pressure_pa - self.gas.P0
            if beyond := reason_against_gas(change, self.gas):
                return self._nothing("implausible", beyond), WarmStart(start.model)
            gas = change / self.scales.pressure_pa
        observation, model, answer = self._solve(depth_m, gas, start)
        if answer is None or answer.status == "implausible":
            status: Status = "no_data" if answer is None else answer.status
            return self._nothing(status, STATUS_REASONS[status]), WarmStart(model)
        misfit = self.observer.misfit(observation, model.linear, answer.displacement_m)
        doubt = GAS_CONTRADICTS if answer.contradicts_gas else ""
        if doubt := doubt or reason_against_fit(misfit, self.observer.white):
            return self._nothing("implausible", doubt, misfit.rms_m), WarmStart(model)
        touching = answer if answer.pressure.any() else None
        return self._report(misfit, answer), WarmStart(model, touching)

    def _solve(
        self, depth_m: np.ndarray, gas: float | None, start: WarmStart
    ) -> tuple[Observation, _LocalModel, _Answer | None]:
        """Linearise where the last frame ended, and again where this one does.

        A second pass is also due where the first took for outliers what was a new dent. From then
        on a first frame gets nearer with every pass, unless its depths are of something else:
        steps that grow, each to another answer, lead nowhere and would take seconds.
        """
        recast, cold = self.options.relinearisations > 0, start.answer is None
        model, answer, solve_ms = start.model, start.answer, 0.0
        before = np.inf
        here = answer.displacement_m if answer else np.zeros(len(self.mesh.nodes))
        # From rest a dent is reached in steps; a seek ends where playing the recording would.
        casts, settled_m = (1, self._far_m) if answer else (_COLD, self._near_m)
        measured = self.observer.measure(depth_m)
        for number in range(1 + casts * self.options.relinearisations if recast else 2):
            model = self._around(here if recast else np.zeros_like(here), model)
            expected = self.observer.predict(model.linear, here)
            observation = self.observer.weigh(measured, expected)
            seen = observation.weight > 0.0
            if np.count_nonzero(seen) < MINIMUM_BLOCKS:
                return observation, model, None
            if median(np.abs(observation.residual_m[seen])) > self.scales.length_m:
                return observation, model, self._out_of_reach
            answer = self._solve_linear(observation, model.linear, gas, answer)
            solve_ms += answer.solve_ms
            moved = float(np.max(np.abs(answer.displacement_m - here)))
            here = answer.displacement_m
            if cold and number > 1 and moved > max(before, self._far_m):
                return observation, model, self._out_of_reach
            before = moved
            settled = moved <= settled_m or (not recast and observation.trusted == 1.0)
            if settled or answer.status == "implausible":
                break
        return observation, model, replace(answer, solve_ms=solve_ms) if answer else None

    def _around(self, displacement_m: np.ndarray, model: _LocalModel) -> _LocalModel:
        """The model made valid around a displacement; rays that still meet it are not cast anew."""
        if np.max(np.abs(displacement_m - model.cast_at_m)) > self._far_m:
            linear = self.observer.linearise(displacement_m)
            return _LocalModel(linear, displacement_m, displacement_m)
        moved = np.abs(displacement_m - model.linear_at_m) > self._near_m
        if not moved.any():
            return model
        around = moved[self.mesh.corners].any(axis=0)
        nodes = self.mesh.triangles[around]
        linear_at_m = model.linear_at_m.copy()
        linear_at_m[nodes] = displacement_m[nodes]
        linear = self.observer.relinearise(model.linear, displacement_m, around)
        return _LocalModel(linear, model.cast_at_m, linear_at_m)

    @property
    def _out_of_reach(self) -> _Answer:
        """Ranges that differ from the membrane's by more than its size: other units, perhaps."""
        zero = np.zeros(len(self.mesh.free))
        return _Answer(np.zeros(len(self.mesh.nodes)), 0.0, zero, zero, 0, "implausible", 0.0)

    def _solve_linear(
        self,
        observation: Observation,
        linear: Linearisation,
        gas: float | None,
        start: _Answer | None,
    ) -> _Answer:
        problem = self._problem(observation, linear, gas)
        nothing = Pressure(np.zeros(len(problem.g)), 0, True)
        if np.all(problem.at_zero + problem.tau >= 0.0):
            # The KKT conditions hold at p_c = 0: no contact, and no QP to solve.
            return self._answer(problem, nothing, nothing)
        first = start.selected if start is not None else nothing.values
        began = time.perf_counter()
        selected = self._solver.select(problem, first)
        free = problem.debiased(selected.values > 0.0)
        refined = self._solver.refine(free, selected)
        solve_ms = 1e3 * (time.perf_counter() - began)
        if np.max(refined.values, initial=0.0) < self._held + (problem.measured_gas or 0.0):
            return self._answer(problem, selected, nothing, solve_ms)
        return self._answer(free, selected, refined, solve_ms)

    def _problem(
        self, observation: Observation, linear: Linearisation, gas: float | None
    ) -> FrameProblem:
        a = self.scales.length_m
        Q, g = self._normal.assemble(observation, linear)
        Q.data *= a**2
        g *= a
        tau = self._tau * np.sqrt(Q.diagonal().sum() / self._weight)
        if gas is not None:
            tau = tau + self._gas_tau
        at_zero = self._equilibrium.gradient_at_zero(Q, g, gas)
        return FrameProblem(Q, g, self._lambda, tau, at_zero, np.ones(len(g), bool), gas)

    def _answer(
        self, problem: FrameProblem, selected: Pressure, refined: Pressure, solve_ms: float = 0.0
    ) -> _Answer:
        eq = self._equilibrium
        displacement, gas = eq.displacement(refined.values, problem.measured_gas)
        converged = selected.converged and refined.converged
        status: Status = "ok" if refined.values.any() else "no_contact"
        if not np.max(np.abs(displacement)) < 1.0:  # in units of the membrane's size; or NaN
            status = "implausible"
        elif not converged or (problem.measured_gas is None and abs(gas) > self._gas_limit):
            status = "not_converged"
        residual = 0.0
        if refined.values.any():
            gradient = refined.gradient
            if gradient is None:
                gradient = eq.gradient(problem, refined.values)
            residual = natural_residual(eq.A, problem, refined.values, gradient)
        return _Answer(
            self._on_nodes(self.scales.length_m * displacement),
            gas,
            selected.values,
            refined.values,
            selected.iterations + refined.iterations,
            status,
            residual,
            bool(refined.values.any())
            and contradicts_gas(problem, eq.bulge, displacement, self._gas_noise),
            solve_ms,
        )

    def _on_nodes(self, values: np.ndarray) -> np.ndarray:
        field = np.zeros(len(self.mesh.nodes))
        field[self.mesh.free] = values
        return field

    def _report(self, misfit: Misfit, answer: _Answer) -> Estimate:
        return Estimate(
            status=answer.status,
            displacement_m=answer.displacement_m,
            contact_pressure_pa=self._on_nodes(self.scales.pressure_pa * answer.pressure),
            gas_pressure_change_pa=self.scales.pressure_pa * answer.gas,
            residual_rms_m=misfit.rms_m,
            kkt_residual=answer.kkt_residual,
            iterations=answer.iterations,
            solve_ms=answer.solve_ms,
            reason=STATUS_REASONS.get(answer.status, ""),
        )

    def _nothing(self, status: Status, reason: str, misfit_m: float = np.nan) -> Estimate:
        """A frame about which nothing is known."""
        zero = np.zeros(len(self.mesh.nodes))
        return Estimate(status, zero, zero, np.nan, misfit_m, np.nan, reason=reason)
