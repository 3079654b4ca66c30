"""From depth, and optical flow, to shape, contact pressure, friction and gas pressure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi, sqrt

import numpy as np

from bubbleviz.camera import UPPER_95, ImageErrors, Measured, MeasuredFlow, RangeObserver
from bubbleviz.errors import InputError, check_number
from bubbleviz.inverse.friction import FRICTION, contacts_seen_by_flow
from bubbleviz.inverse.gauss_newton import IMAGE_ERROR, GaussNewton
from bubbleviz.inverse.iteration import Iteration, SolvedFrame, Start, is_untouched
from bubbleviz.inverse.measurements import FrameData
from bubbleviz.inverse.noise import AS_EXPECTED
from bubbleviz.inverse.plausibility import (
    GAS_CONTRADICTS,
    IMPLAUSIBLE_MISFIT,
    STATUS_REASONS,
    reason_against_camera,
    reason_against_fit,
    reason_against_gas,
)
from bubbleviz.inverse.resolution import at_noise
from bubbleviz.inverse.response import Bubble, RubberBubble
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import LAG
from bubbleviz.result import Estimate, Status, wrench_about

PRESSURE_SCALE = 3.0
"""Contact pressure in gauge pressures that the prior expects: P (1 + R/r) on an object with a
radius of curvature r half that of the bubble, R (Young–Laplace on both sides)."""

RIM_SLACK_M = 1.5e-4
"""Motion of the exact membrane's rim under the pull of the mean tension, m: how precisely a clamp
holds rubber."""

MAX_NODES = 20_000
"""Beyond this a frame would take minutes."""

RUBBER, LINEAR, PAPER = "rubber", "linear", "paper"
"""The exact membrane; constant tension along the normals; and that by the paper's QP (Eq. 23)."""
BASE_MESH = {f"{name}-base": name for name in (RUBBER, LINEAR)}
"""Names for the sensor's own mesh alone: no finer one at the contact."""
ESTIMATORS = (RUBBER, LINEAR, PAPER, *BASE_MESH)
"""Names for `EstimatorOptions.named` that take the sensor's mesh, or another size of it."""
SOLVER_NAMES = (*ESTIMATORS, "fast")
"""Names for `EstimatorOptions.named`; `fast` is the linear model on a coarse mesh."""
DROPPED = {
    "osqp": "it was renamed to paper in 0.3; use paper",
    "osqp-cold": "it was renamed to paper in 0.3; use paper",
    "clarabel": "it was removed in 0.3; use linear, which solves the same problem",
}
"""Solvers of version 0.2 and what replaces them."""


@dataclass(frozen=True)
class EstimatorOptions:
    """Options of the estimator.

    Attributes
    ----------
    solver : str or None
        `rubber`, `linear` or `paper`; None for rubber where the sensor's pre-stretch is known and
        `linear` where it is not.
    nodes : int or None
        Number of nodes of the mesh of an analytic dome; None for the sensor file's.
    pressure_scale : float
        Contact pressure in gauge pressures that the prior expects, see `PRESSURE_SCALE`.
    block : int or None
        Side of the squares of pixels that are averaged; None for half a mesh edge.
    rim_slack_m : float
        Compliance of the rim of the exact membrane, see `RIM_SLACK_M`.
    fine_contact : bool
        Whether the contact is solved on a finer mesh where the mesh limits its resolution, see
        `contact_refiner`; never with the paper's QP.
    friction : float
        Standard deviation of the coefficients of friction of contacts with the exact membrane, see
        `friction_nuisances`; 0 for contacts without friction.
    friction_given : bool
        Whether the user chose that, for a warning where it changes nothing.
    image_error : float
        Standard deviation, over the depth, of errors common to a whole depth image since
        calibration: an offset, a scale and tilts; a tenth for a shift of the camera. 0 for none.
    """

    solver: str | None = None
    nodes: int | None = None
    pressure_scale: float = PRESSURE_SCALE
    block: int | None = None
    rim_slack_m: float = RIM_SLACK_M
    fine_contact: bool = True
    friction: float = FRICTION
    friction_given: bool = False
    image_error: float = IMAGE_ERROR

    @classmethod
    def named(cls, name: str | None, friction: float | None = None) -> EstimatorOptions:
        """Options of a `--solver` name, and of a `--friction` in place of the default.

        The name is `fast`, a solver's own, or None for the default.

        Raises
        ------
        InputError
            There is no such solver, or the friction is not a number ≥ 0.
        """
        if friction is not None:
            check_number("--friction", friction, 0.0)
            return replace(cls.named(name), friction=friction, friction_given=True)
        if name == "fast":
            # A coarse mesh takes larger blocks of pixels and fewer rays too.
            return cls(LINEAR, nodes=400, fine_contact=False)
        if name in BASE_MESH:
            return cls(BASE_MESH[name], fine_contact=False)
        if name in DROPPED:
            raise InputError(f"solver {name}: {DROPPED[name]}")
        return cls(LINEAR if name == "active-set" else name)  # its name up to version 0.1


class Estimator:
    """Solves the inverse problem frame by frame, with warm starts.

    Contact acts along the current normals on the support of maximal evidence, and friction along
    the membrane, see `friction_nuisances`; everywhere else the membrane is in equilibrium by
    construction. A connected part of the support whose pressure is below the gas pressure
    everywhere is not contact, as any part that lies on a flat or convex object carries that
    pressure. Nor is one that is not significant, see `significant_contact`.

    Parameters
    ----------
    observer : RangeObserver
    bubble : Bubble
        Of rubber, or of constant tension.
    options : EstimatorOptions, optional

    Attributes
    ----------
    solver_name : str
    size_m : float
        Radius of a disc of the membrane's area, m.
    held_pressure_pa : float
        Gauge pressure of the reference configuration; a contact that flattens it carries that.
    prior_weight : float
        λ of the H1 term, 1/Pa².
    smoothness : (n, n) sparse array
        λ L of the H1 term.
    information : float
        Weight of all ranges over the membrane's area, 1/m⁴.
    resolution_m : float
        Width of the estimate's response to a point load, m, at the noise of the camera; estimates
        contain that of their frame.
    """

    def __init__(
        self,
        observer: RangeObserver,
        bubble: Bubble,
        options: EstimatorOptions | None = None,
    ) -> None:
        self.mesh = observer.mesh
        if len(self.mesh.nodes) > MAX_NODES:
            raise InputError(
                f"the mesh of the sensor file has {len(self.mesh.nodes):,} nodes, more than "
                f"{MAX_NODES:,}; coarsen it (membrane.nodes, or its mesh file), or identify the "
                "sensor again, with 1000 nodes (--nodes)"
            )
        self.observer, self.bubble = observer, bubble
        self.options = options or EstimatorOptions()
        exact = isinstance(bubble, RubberBubble)
        self.solver_name = RUBBER if exact else LINEAR
        self.held_pressure_pa = bubble.held_pressure_pa
        self.prior_weight = (self.options.pressure_scale * self.held_pressure_pa) ** -2.0
        self.size_m = size = sqrt(self.mesh.facet_areas.sum() / pi)
        friction = self.options.friction if exact else 0.0
        self._newton = GaussNewton(
            observer, bubble, self.prior_weight, size, friction, self.options.image_error
        )
        self.smoothness, self.resolution_m = self._newton.smoothness, self._newton.resolution_m
        self.information = self._newton.weight_density

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
        """Estimate of one frame, and the warm start of the next one.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth, NaN where there is no return.
        gas_pressure_pa : float, optional
            Measured absolute gas pressure.
        start : Start, optional
            Of the previous frame; None: solve from rest.
        gas_sigma_pa : float
            Standard deviation of the zero of the gas pressure, Pa.
        flow : MeasuredFlow, optional
            Of the colour image of the same moment; the membrane must be the exact one.
        image_errors : ImageErrors, optional
            Of the depth image, as known from images without contact; by default those of a camera
            that was not moved since the calibration, unless the image contradicts them.
        noise : float
            Noise factor of the depth image averaged over blocks of pixels, likewise.
        """
        start, newton, behind = start or Start(), self._newton, self.bubble.gas
        if gas_sigma_pa:
            newton = newton.with_gas(replace(behind, zero_sigma_pa=gas_sigma_pa))
        gas = behind.measured_change(gas_pressure_pa)
        if gas is not None and (beyond := reason_against_gas(gas, behind)):
            return no_estimate(self.mesh, "implausible", beyond), Start()
        known = image_errors or newton.drift_prior
        data = FrameData(self.observer.measure(depth_m).at_noise(noise), gas, None, known)
        found = self._solve_frame(newton, data, start)
        if start.state is not None and found[0].status in ("not_converged", "implausible"):
            # a warm start far from the solution, as after a jump, may fail where rest does not
            found = self._solve_frame(newton, data, Start())
        if flow is None:
            return found
        return self._with_flow(newton, replace(data, flow=flow), start, *found)

    def _with_flow(
        self, newton: GaussNewton, data: FrameData, before: Start, alone: Estimate, start: Start
    ) -> tuple[Estimate, Start]:
        """Estimate by depth and flow, and the next warm start, from those by depth alone.

        `before` is the warm start of this frame. Optical flow of another moment, or of something
        other than the membrane, pulls the shape away from the depth image: then the estimate by
        depth alone is returned.
        """
        assert data.flow is not None
        pressure, seen = alone.contact_pressure_pa, data.flow.seen
        if not contacts_seen_by_flow(pressure, self.mesh.rings, seen).any():
            return alone, start
        both, by_flow = self._solve_frame(newton, data, _nearest(before, start))
        if both.status != "ok" or _squares_apart(alone, both) > IMPLAUSIBLE_MISFIT**2:
            return replace(alone, flow_contradicts=True), start
        return self._with_disagreement(alone, both), replace(start, by_flow=by_flow)

    def _with_disagreement(self, alone: Estimate, both: Estimate) -> Estimate:
        """Estimate by depth and flow, with the difference of its force in its covariance.

        Added is the part of it that the errors of both do not explain: one of them has an unknown
        error (DerSimonian and Laird 1986). It acts at the centre of the contact.
        """
        excess = 1.0 - 3.0 / max(_squares_apart(alone, both), 3.0)
        assert both.nodal_force_n is not None and both.wrench_covariance is not None
        load = np.linalg.norm(both.nodal_force_n, axis=1)
        center = load @ self.mesh.deformed(both.motion_m) / load.sum()
        apart = wrench_about(-center)[:, :3] @ _apart(alone, both)
        covariance = both.wrench_covariance + excess * np.outer(apart, apart)
        return replace(both, wrench_covariance=covariance)

    def _solve_frame(
        self, newton: GaussNewton, data: FrameData, start: Start
    ) -> tuple[Estimate, Start]:
        """Estimate and next warm start; without the known image errors if these do not fit."""
        answer, doubt = self._solution(newton, data, start)
        if data.image_errors is not None and (isinstance(answer, str) or doubt):
            return self._solve_frame(newton, replace(data, image_errors=None), start)
        if isinstance(answer, str):
            return no_estimate(self.mesh, answer, STATUS_REASONS[answer]), Start()
        if doubt:
            return no_estimate(self.mesh, "implausible", doubt, answer.misfit.rms_m), Start()
        step, touching = answer.step, answer.step.state if answer.touching else None
        start = Start(touching, step.last_tangent, *step.hyperparameters, answer.view)
        return self._report(answer, data.ranges.block_noise), start

    def _solution(
        self, newton: GaussNewton, data: FrameData, start: Start
    ) -> tuple[SolvedFrame | Status, str]:
        """Solution of a frame, or why there is none; and why it is implausible, or nothing."""
        try:
            answer = Iteration(newton, data, start).solve()
        except (RuntimeError, np.linalg.LinAlgError):  # a singular tangent, or Hessian
            answer = "not_converged"
        return answer, "" if isinstance(answer, str) else self._doubt(answer)

    def _doubt(self, answer: SolvedFrame) -> str:
        """Why a solution is implausible; empty if it is not."""
        doubt = GAS_CONTRADICTS if answer.contradicts_gas else ""
        doubt = doubt or reason_against_gas(answer.step.state.gas, self.bubble.gas, measured=False)
        doubt = doubt or reason_against_fit(answer.misfit, self.observer.white, self.size_m)
        errors, moved = answer.step.state.image_errors, self._newton.moved_prior
        return doubt or reason_against_camera(errors, moved)

    @property
    def image_priors(self) -> tuple[ImageErrors, ImageErrors]:
        """Errors of a depth image of which nothing else is known, see `GaussNewton`."""
        return self._newton.drift_prior, self._newton.moved_prior

    def fits_rest(self, measured: Measured) -> bool:
        """Whether an image is explained without contact by the noise of the camera."""
        rest = self._newton.observe(FrameData(measured), self._newton.rest, None)
        return self._newton.fits_without_contact(rest, None)

    def image_noise(self, images_m: Sequence[np.ndarray]) -> tuple[float, float]:
        """Noise of consecutive images (H, W) without contact, averaged over blocks.

        By their changes, which errors of the sensor file do not cause. First its factor: the upper
        95 % limit, and 1 where noise as in that file explains them. Then the variance of the mean
        of many images over that of independent ones with this factor, at least 1. Noise k images
        apart is correlated by aᵏ, as an exponential filter in the camera causes it: changes over
        two images have 1 + a times the variance of those over one. All are worth at least one.
        """
        measured = [self.observer.measure(depth_m) for depth_m in images_m]
        count, lag = len(measured), min(LAG, len(measured) - 1)
        lags = 1, min(2, count - 1), lag
        by_lag = [self.observer.change_noise(measured, each) for each in lags]
        (_, over_one), (_, over_two), (noise, _) = by_lag
        a = max(0.0, over_two / max(over_one, np.finfo(float).tiny) - 1.0)
        a = min(a, (count - 1) / (count + 1))
        limit = 1.0 + (UPPER_95 - 1.0) / sqrt(count - lag)
        noise /= sqrt(1.0 - a**lag)
        factor = AS_EXPECTED.with_ranges(limit * noise).ranges if noise > limit else 1.0
        return factor, max(1.0, (noise / factor) ** 2 * (1.0 + a) / (1.0 - a))

    def is_untouched(self, depth_m: np.ndarray, noise: float = 1.0) -> bool:
        """Whether an image (H, W), without the gas pressure, is explained without contact."""
        try:
            return is_untouched(self._newton, self.observer.measure(depth_m).at_noise(noise))
        except (RuntimeError, np.linalg.LinAlgError):  # a singular tangent, or Hessian
            return False

    def _report(self, answer: SolvedFrame, block_noise: float) -> Estimate:
        state, contact = answer.step.state, answer.step.contact
        moved = state.x - self.mesh.nodes
        force, noise_factor = state.nodal_force, block_noise * answer.noise.ranges
        return Estimate(
            status="ok" if answer.touching else "no_contact",
            displacement_m=np.einsum("ij,ij->i", moved, self.mesh.normals),
            contact_pressure_pa=state.pressure,
            averaged_pressure_pa=contact.problem.averaged_pressure(contact.pressure),
            gas_pressure_change_pa=state.gas,
            residual_rms_m=answer.misfit.rms_m,
            kkt_residual=contact.problem.kkt_residual(contact.pressure),
            iterations=contact.pivots,
            solve_ms=answer.solve_ms,
            displacement_3d_m=moved,
            nodal_force_n=force,
            friction_n=state.friction,
            force_n=force.sum(axis=0),
            wrench_covariance=answer.wrench_covariance,
            gas_law_pa=self.bubble.gas_at(state.x)[0],
            resolution_m=at_noise(self.resolution_m, noise_factor),
            noise_factor=noise_factor,
            seen_share=answer.visible_share,
            image_errors=answer.image_errors,
            flow=answer.flow,
            caveat=self.bubble.caveat,
        )


def _nearest(before: Start, alone: Start) -> Start:
    """Start of the solution with flow: this frame's by depth alone, or the last frame's with flow.

    The latter if the shape has moved less since the last frame than flow had changed it there.
    """
    last = before.by_flow
    if last is None or last.state is None or before.state is None or alone.state is None:
        return alone
    moved, by_flow = (np.abs(each.x - before.state.x).max() for each in (alone.state, last.state))
    if moved > by_flow:
        return alone
    return replace(last, state=replace(last.state, support=alone.state.support))


def _apart(alone: Estimate, both: Estimate) -> np.ndarray:
    """Force by depth and flow minus force by depth alone, (3,), N."""
    assert alone.force_n is not None and both.force_n is not None
    return both.force_n - alone.force_n


def _squares_apart(alone: Estimate, both: Estimate) -> float:
    """χ² of that difference, of three degrees of freedom.

    Both have partly the same errors: the sum of their covariances is an upper bound.
    """
    assert alone.wrench_covariance is not None and both.wrench_covariance is not None
    apart = _apart(alone, both)
    covariance = (alone.wrench_covariance + both.wrench_covariance)[:3, :3]
    return float(apart @ np.linalg.solve(covariance, apart))


def no_estimate(
    mesh: MembraneMesh, status: Status, reason: str, misfit_m: float = np.nan
) -> Estimate:
    """Estimate of a frame that was not solved."""
    zero, three = np.zeros(len(mesh.nodes)), np.full(3, np.nan)
    return Estimate(
        status,
        zero,
        zero,
        np.nan,
        misfit_m,
        np.nan,
        displacement_3d_m=np.zeros((len(zero), 3)),
        force_n=three,
        wrench_covariance=np.full((6, 6), np.nan),
        reason=reason,
    )
