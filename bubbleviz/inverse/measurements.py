"""Measurements of a frame, and their residuals at a shape of the membrane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from bubbleviz.camera import ImageErrors, Measured, MeasuredFlow, Observation, ShapeRanges
from bubbleviz.inverse.noise import AS_EXPECTED, Noise


@dataclass(frozen=True)
class FrameData:
    """Measurements of one frame.

    Attributes
    ----------
    ranges : Measured
    gas_pa : float or None
        p_v, Pa; None: computed from the volume.
    flow : MeasuredFlow or None
        Of the colour image; None: depth alone.
    image_errors : ImageErrors or None
        As known before; None: of a camera that may have been moved.
    """

    ranges: Measured
    gas_pa: float | None = None
    flow: MeasuredFlow | None = None
    image_errors: ImageErrors | None = None


@dataclass(frozen=True)
class Nuisances:
    """Unknown amplitudes, with a prior, that change the measurements besides contact pressure.

    The first m move the membrane, the others are errors of the measurements.

    Attributes
    ----------
    motions : (n, 3, m) array
        B: motion of the membrane under a unit of each, m.
    forces : (n, 3, m) array
        Contact forces on the nodes for a unit of each, N.
    errors : (r, e) array
        E: error of the first r measurements under a unit of each.
    mean : (m + e,) array
        Of their prior.
    root : (m + e, m + e) array
        F: its covariance is F Fᵀ; 0 for amplitudes that are fixed.
    """

    motions: np.ndarray
    forces: np.ndarray
    errors: np.ndarray
    mean: np.ndarray
    root: np.ndarray

    @classmethod
    def none(cls, nodes: int) -> Nuisances:
        """No nuisances, for a membrane with a number of nodes."""
        return cls.joined([], np.zeros((0, 0)), nodes)

    @classmethod
    def joined(
        cls, moving: Sequence[tuple[np.ndarray, np.ndarray]], errors: np.ndarray, nodes: int
    ) -> Nuisances:
        """Motions and forces (nodes, 3, …) of several, and errors (r, e); all fixed to zero."""
        nothing = np.zeros((nodes, 3, 0))
        motions, forces = (
            np.concatenate([nothing, *each], axis=2)
            for each in (zip(*moving, strict=True) if moving else ((), ()))
        )
        count = motions.shape[2] + errors.shape[1]
        return cls(motions, forces, errors, np.zeros(count), np.zeros((count, count)))

    def moved(self, amplitudes: np.ndarray) -> np.ndarray:
        """Motion (n, 3) for amplitudes (m + e,), m."""
        motion: np.ndarray = self.motions @ amplitudes[: self.motions.shape[2]]
        return motion

    def force(self, amplitudes: np.ndarray) -> np.ndarray:
        """Contact forces (n, 3) for amplitudes (m + e,), N."""
        force: np.ndarray = self.forces @ amplitudes[: self.forces.shape[2]]
        return force

    def error(self, amplitudes: np.ndarray) -> np.ndarray:
        """Errors (r,) of the first measurements for amplitudes (m + e,)."""
        error: np.ndarray = self.errors @ amplitudes[self.motions.shape[2] :]
        return error


@dataclass(frozen=True)
class Measurements:
    """Residuals of ranges and optical flow at a shape: derivative, weights and nuisances.

    Attributes
    ----------
    jacobian : (k, 3n) sparse array
        D.
    error : (k,) array
        e: measured minus modelled, ranges in m, then components of flow in pixels.
    weight : (k,) array
        1/σ².
    nuisances : Nuisances
    """

    jacobian: sparse.csr_array
    error: np.ndarray
    weight: np.ndarray
    nuisances: Nuisances

    @cached_property
    def transposed(self) -> sparse.csc_array:
        """Dᵀ, (3n, k)."""
        return self.jacobian.T

    @cached_property
    def by_nuisances(self) -> np.ndarray:
        """R = D B + E: change by a unit of each nuisance, (k, a)."""
        motions, errors = self.nuisances.motions, self.nuisances.errors
        (count, unknowns), moving = self.jacobian.shape, motions.shape[2]
        changes = np.zeros((count, moving + errors.shape[1]))
        changes[:, :moving] = self.jacobian @ motions.reshape(unknowns, moving)
        changes[: len(errors), moving:] = errors
        return changes

    @cached_property
    def nuisances_weighed(self) -> np.ndarray:
        """W R, (k, a)."""
        return self.weight[:, None] * self.by_nuisances

    def with_prior(self, mean: np.ndarray, root: np.ndarray, factor: float) -> Measurements:
        """The same with another prior of the amplitudes, and all weights times a factor."""
        other = replace(
            self,
            weight=factor * self.weight,
            nuisances=replace(self.nuisances, mean=mean, root=root),
        )
        kept = {"transposed", "by_nuisances"}  # which do not depend on them
        kept |= {"nuisances_weighed", "information"} if factor == 1.0 else set()
        known = vars(self) | {"by_nuisances": self.by_nuisances}
        vars(other).update({name: known[name] for name in kept & known.keys()})
        return other

    @cached_property
    def information(self) -> np.ndarray:
        """RᵀWR, (a, a)."""
        information: np.ndarray = self.nuisances_weighed.T @ self.by_nuisances
        return information

    @cached_property
    def nuisance_covariance(self) -> np.ndarray:
        """(Σ⁻¹ + RᵀWR)⁻¹: covariance of the amplitudes given everything else, (a, a)."""
        root = self.nuisances.root  # may be singular
        scaled = np.linalg.inv(np.eye(len(root)) + root.T @ self.information @ root)
        return np.asarray(root @ scaled @ root.T)

    def change_of_amplitudes(self, change: np.ndarray) -> np.ndarray:
        """Change (a, …) of the most likely amplitudes for changes (k, …) of the residual."""
        return self.nuisance_covariance @ (self.nuisances_weighed.T @ change)

    def amplitudes(self, unexplained: np.ndarray) -> np.ndarray:
        """Most likely amplitudes (a,) for an unexplained residual (k,)."""
        mean = self.nuisances.mean
        if mean.any():
            unexplained = unexplained - self.by_nuisances @ mean
        return mean + self.change_of_amplitudes(unexplained)

    def weighed(self, residual: np.ndarray) -> np.ndarray:
        """W times the part of a residual (k,) that nuisances do not explain (Woodbury)."""
        return self.weight * residual - self.nuisances_weighed @ self.amplitudes(residual)


@dataclass(frozen=True)
class FlowResidual:
    """Optical flow, linearised at a shape.

    Attributes
    ----------
    measured : MeasuredFlow
    jacobian : (2 j, 3n) sparse array
        Of the modelled motions, px/m.
    error_px : (2 j,) array
        Measured minus modelled.
    """

    measured: MeasuredFlow
    jacobian: sparse.csr_array
    error_px: np.ndarray

    @classmethod
    def at(cls, nodes: np.ndarray, measured: MeasuredFlow) -> FlowResidual:
        """Residual at a shape, nodes (n, 3) in B, m."""
        model = measured.at(nodes)
        return cls(measured, model.jacobian, (measured.moved_px - model.moved_px).ravel())

    def weight(self, noise: float) -> np.ndarray:
        """1/σ² at a noise factor, (2 j,), 1/px²."""
        return np.repeat(1.0 / (noise * self.measured.sigma_px) ** 2, 2)

    def noise_factor(self, motion: np.ndarray) -> float:
        """Noise factor of the residual after a motion (n, 3)."""
        return self.measured.noise_factor(self.after(motion).reshape(-1, 2))

    def after(self, motion: np.ndarray) -> np.ndarray:
        """Residual (2 j,) after a motion (n, 3), to first order."""
        left: np.ndarray = self.error_px - self.jacobian @ motion.ravel()
        return left


@dataclass(frozen=True)
class LinearisedFrame:
    """Camera model linearised at a shape, and the residual of an image there.

    Attributes
    ----------
    view : ShapeRanges
    observation : Observation
    measured_m : (k,) array
        Ranges of the blocks in `view` minus those at rest and the expected errors of the image.
    image_errors_m : (k, e) array
        Range errors of those blocks under a unit of each error of the whole image.
    image_prior : ImageErrors
        Prior of these errors.
    border : (k, b) array
        Range errors of those blocks under a unit of each error beside missing returns.
    flow : FlowResidual or None
    """

    view: ShapeRanges
    observation: Observation
    measured_m: np.ndarray
    image_errors_m: np.ndarray
    image_prior: ImageErrors
    border: np.ndarray
    flow: FlowResidual | None

    @cached_property
    def error_m(self) -> np.ndarray:
        """Measured minus modelled ranges of the blocks in `view`, (k,)."""
        error: np.ndarray = self.measured_m - self.view.model_m[self.view.block]
        return error

    @property
    def weight(self) -> np.ndarray:
        """1/σ² of the blocks in `view`, (k,), 1/m²."""
        return self.observation.weight[self.view.block]

    @cached_property
    def seen(self) -> np.ndarray:
        """Nodes of the facets that are measured, (n,) bool."""
        corners = self.view.jacobian.indices.reshape(-1, 9)[self.weight > 0.0, ::3] // 3
        seen = np.zeros(self.view.jacobian.shape[1] // 3, bool)
        seen[corners] = True
        return seen

    @property
    def seen_by_flow(self) -> np.ndarray:
        """Nodes next to which flow was measured, (n,) bool."""
        nodes = self.view.jacobian.shape[1] // 3
        return np.zeros(nodes, bool) if self.flow is None else self.flow.measured.seen

    def residual_m(self, motion: np.ndarray, image_error_m: np.ndarray) -> np.ndarray:
        """Errors (k,) of the ranges after a motion (n, 3), to first order, minus others (k,)."""
        left: np.ndarray = self.error_m - self.view.jacobian @ motion.ravel() - image_error_m
        return left

    @cached_property
    def misfit(self) -> float:
        """χ² of the residual, minimised over the errors of the whole image."""
        return self._misfit(self.error_m)

    def fits_rest_better(self, error_m: np.ndarray) -> bool:
        """Whether the membrane at rest has a smaller misfit than errors (k,)."""
        return self._misfit(error_m) > self._misfit(self.measured_m)

    def _misfit(self, error_m: np.ndarray) -> float:
        return float(error_m @ self._by_image.weighed(error_m))

    def without_image_errors(self, error_m: np.ndarray) -> np.ndarray:
        """Errors (k,) minus the fitted errors of the whole image."""
        explained: np.ndarray = self.image_errors_m @ self._by_image.amplitudes(error_m)
        return error_m - explained

    def measurements(
        self, noise: Noise, moving: Sequence[tuple[np.ndarray, np.ndarray]]
    ) -> Measurements:
        """Ranges and flow at noise factors, with nuisances that are fixed to zero.

        Parameters
        ----------
        noise : Noise
        moving : sequence of (n, 3, m) arrays
            Motions of the membrane under a unit of each nuisance, and their forces.
        """
        jacobian, error, weight = self.view.jacobian, self.error_m, self.weight / noise.ranges**2
        if self.flow is not None:
            jacobian = sparse.vstack([jacobian, self.flow.jacobian], format="csr")
            error = np.concatenate([error, self.flow.error_px])
            weight = np.concatenate([weight, self.flow.weight(noise.flow)])
        errors_m = np.hstack([self.border, self.image_errors_m])
        nuisances = Nuisances.joined(moving, errors_m, jacobian.shape[1] // 3)
        return Measurements(jacobian, error, weight, nuisances)

    @cached_property
    def _by_image(self) -> Measurements:
        """Ranges with errors of the whole image as their only nuisances."""
        ranges = replace(self, border=self.border[:, :0], flow=None)
        alone = ranges.measurements(AS_EXPECTED, [])
        return alone.with_prior(alone.nuisances.mean, self.image_prior.units, 1.0)
