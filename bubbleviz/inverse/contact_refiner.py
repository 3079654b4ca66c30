"""Solve the contact on a finer mesh where the mesh, not the noise, limits its resolution.

Only the triangles around the contact are refined (cut into four, around a small contact once more),
and only the part of the membrane around them is solved for: shape beyond some rings and gas
pressure are fixed to the estimate (submodelling). The cost depends on the size of the contact, not
of the membrane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.camera import SQUARES, RangeObserver, RayCaster, camera_shift
from bubbleviz.errors import InputError
from bubbleviz.inverse.contact_problem import (
    ContactProblem,
    Prior,
    Selection,
    smoothness,
    touching_parts,
)
from bubbleviz.inverse.estimator import Estimator
from bubbleviz.inverse.measurements import Measurements, Nuisances
from bubbleviz.inverse.resolution import at_noise, resolution_m
from bubbleviz.inverse.response import Bubble, ConstantTension, RubberBubble
from bubbleviz.membrane import Refined, grown, refined_part
from bubbleviz.result import Estimate, FineContact
from bubbleviz.sensor_model import SensorModel

_SENSOR_LIMIT, _FRAME_LIMIT = 0.42, 0.65
"""Limits, in mesh edges, up to which the contact is refined: of the resolution at the noise of an
image, below which the mesh limits the patch; and of the resolution at the noise factor of the
frame. Chosen on presses of 14 objects: IoU gains 0.05 to 0.15 up to 0.4 of the former, and at most
0.01 from 0.45 on; presses into rubber gain up to 0.6 of the latter. Single images of shipped
sensors are not refined; those of identified sensors with up to 0.15 mm of noise are. On a dome
pressed by another solver (0.05 mm), 1,000 nodes have an IoU of 0.96 with refinement and 0.89
without; 3,000 nodes have 0.95 and take six times as long.
"""
_MOST_NODES, _MOST_TWICE = 100, 10.0
"""Most nodes of a contact that is refined, and most `_effective_nodes` (about 12 nodes) of one that
is refined twice: the time grows with the square of the number of finer nodes, and is about 80 ms
for the 200 finer nodes of a contact that is refined twice. Nodes with little load, in which two
estimates of a frame may differ, hardly count."""
_FINER_RINGS, _MOVING_RINGS = 2, 6
"""Rings of nodes around the contact that are refined, and further rings that may move. In the
hold of the real press, the area differs with 4 of the latter, not with 6."""
_STEPS = 2
"""Gauss–Newton steps: the first with the noise factor of the estimated shape, which includes errors
of its mesh; the second with the noise factor by the residual of the first, without smooth errors.
After two refinements one more, with the tangent of the second, as that residual still contains
errors of the first mesh. With one tangent for all of them, areas of one frame differ by 5 %."""


@dataclass(frozen=True)
class _Part:
    """Submodel around one contact.

    Attributes
    ----------
    touching : (n,) bool array
        Nodes of the whole mesh around which triangles are refined.
    twice : bool
        Whether refined twice.
    finer : Refined
    observer : RangeObserver
    bubble : Bubble
    prior : Prior
    smooth : (b, 6) array
        See `_smooth_errors`.
    resolution_m : float
        At the noise of the camera.
    """

    touching: np.ndarray
    twice: bool
    finer: Refined
    observer: RangeObserver
    bubble: Bubble
    prior: Prior
    smooth: np.ndarray
    resolution_m: float


class ContactRefiner:
    """Solves frames again around their contact, on a refined mesh; use it if `mesh_limits`.

    Parameters
    ----------
    model : SensorModel
    estimator : Estimator
        Of the same sensor.
    """

    def __init__(self, model: SensorModel, estimator: Estimator) -> None:
        self._model, self._estimator = model, estimator
        # of the mean error of a square, by which noise factors are determined
        of_square = estimator.information * model.mesh.facet_areas.sum() / SQUARES
        self._mean_sigma_m = float(of_square) ** -0.5
        self._last: dict[bool, _Part] = {}  # by whether refined twice

    def refine(
        self, depth_m: np.ndarray, estimate: Estimate, mean_noise: float = 1.0
    ) -> FineContact | None:
        """Contact of a frame on a finer mesh; None if that would not improve it.

        Parameters
        ----------
        depth_m : (H, W) array
            z-depth, m; NaN where there is no return.
        estimate : Estimate
            Of this frame.
        mean_noise : float
            σ of its noise over that of the camera, if it is a mean of images.
        """
        camera = self._estimator.resolution_m
        nominal = at_noise(camera, mean_noise)
        resolution = estimate.resolution_m or nominal
        if resolution > _FRAME_LIMIT * self._model.mesh.edge_length:
            return None
        pressure = estimate.contact_pressure_pa
        gas = self._gas_pressure(estimate)
        touching = touching_parts(self._model.mesh, pressure > 0.0, pressure, gas, resolution)
        if not 0 < np.count_nonzero(touching) <= _MOST_NODES:
            return None
        small = _effective_nodes(pressure[touching]) <= _MOST_TWICE
        limit_m = 0.5 * _FRAME_LIMIT * self._model.mesh.edge_length  # of the mesh refined once
        for twice in (True, False) if small and nominal <= limit_m else (False,):
            try:
                fine = self._solve(self._part(touching, twice), depth_m, estimate, mean_noise)
            except (RuntimeError, np.linalg.LinAlgError, InputError):
                continue  # a singular tangent, or Hessian; or no pixel sees the part
            if fine and not (twice and fine.resolution_m > limit_m):
                return fine
        return None

    def _gas_pressure(self, estimate: Estimate) -> float:
        """Gauge pressure of the gas, Pa, which every contact reaches somewhere."""
        return self._estimator.held_pressure_pa + estimate.gas_pressure_change_pa

    def _part(self, touching: np.ndarray, twice: bool) -> _Part:
        """Submodel around nodes (n,) bool in contact; the last one is reused if it is the same."""
        if twice not in self._last or not np.array_equal(touching, self._last[twice].touching):
            self._last[twice] = self._built(touching, twice)
        return self._last[twice]

    def _built(self, touching: np.ndarray, twice: bool) -> _Part:
        estimator, whole = self._estimator, self._model.mesh
        cut = _within(whole.rings, touching, _FINER_RINGS)
        inside = _within(whole.rings, cut, _MOVING_RINGS)[whole.triangles].all(axis=1)
        finer = refined_part(whole, inside, cut[whole.triangles].all(axis=1))
        if twice:
            near = grown(finer.mesh.rings, finer.values(touching.astype(float)) > 0.0)
            finer = finer.again(near[finer.mesh.triangles].all(axis=1))
        mesh, observer = finer.mesh, self._observer(finer)
        prior = Prior(
            smoothness(mesh, estimator.prior_weight), np.zeros(len(mesh.nodes)), mesh.rings
        )
        information = float(observer.observe_everything().weight.sum() / mesh.facet_areas.sum())
        return _Part(
            touching,
            twice,
            finer,
            observer,
            self._bubble(finer),
            prior,
            _smooth_errors(observer),
            resolution_m(estimator.prior_weight, self._model.tension_n_per_m, information),
        )

    def _bubble(self, finer: Refined) -> Bubble:
        whole = self._estimator.bubble
        if isinstance(whole, RubberBubble):
            membrane = whole.membrane.on(finer.mesh, finer.parent)
            return RubberBubble(membrane, whole.gas)
        return ConstantTension(finer.mesh, whole.tension_n_per_m, whole.gas.behind(finer.mesh))

    def _observer(self, finer: Refined) -> RangeObserver:
        """Observer of the pixels that see a refined part of the mesh at rest."""
        model, camera, mesh = self._model, self._model.camera, finer.mesh
        within = np.full(len(model.mesh.triangles) + 1, -1)  # the last for pixels that see none
        within[finer.parent] = np.arange(len(finer.parent))
        near = within[model.view.at_rest]
        pixels = np.flatnonzero(near >= 0)
        seen = np.full_like(model.view.at_rest, -1)
        rays = RayCaster(camera.center, camera.directions[pixels], mesh.triangles)
        seen[pixels] = rays.first(mesh.nodes, near=near[pixels])
        block = max(1, self._estimator.observer.block // 2)
        noise = model.sensor.camera.noise_relative
        return RangeObserver(camera, mesh, noise, model.pixels, block, seen)

    def _solve(
        self, part: _Part, depth_m: np.ndarray, estimate: Estimate, mean_noise: float
    ) -> FineContact | None:
        finer, observer, bubble = part.finer, part.observer, part.bubble
        gas, least = estimate.gas_pressure_change_pa, self._gas_pressure(estimate)

        def touches(support: np.ndarray, pressure: np.ndarray) -> np.ndarray:
            return touching_parts(finer.mesh, support, pressure, least, part.resolution_m)

        x = finer.values(self._model.mesh.deformed(estimate.motion_m))
        support = finer.values((estimate.contact_pressure_pa > 0.0).astype(float)) >= 0.5
        support &= ~finer.mesh.rim
        pressure = np.where(support, finer.values(estimate.contact_pressure_pa), 0.0)
        friction = np.zeros_like(x)
        if estimate.friction_n is not None:  # interpolated as a traction
            areas = self._model.mesh.areas[:, None]
            friction = finer.values(estimate.friction_n / areas) * finer.mesh.areas[:, None]
        measured, view, noise = observer.measure(depth_m), None, 1.0
        off_m, shift_m = np.zeros(observer.blocks), None
        if estimate.image_errors is not None:
            off_m = observer.image_errors @ estimate.image_errors.mean
            shift_m = camera_shift(estimate.image_errors.mean)
        for step in range(_STEPS + part.twice):
            view = observer.around(x, view, shift_m)
            expected = view.model_m + off_m
            observation = observer.weigh(measured, expected)
            error = observation.residual_m[view.block] - expected[view.block]
            if not step:
                noise = observer.noise_factor(observation, view.block, error, steady=True)
                beyond_m = np.sqrt(max(noise**2 - mean_noise**2, 0.0)) * self._mean_sigma_m
                root = beyond_m * np.eye(part.smooth.shape[1])
            weight = observation.weight[view.block] / noise**2
            smooth = Nuisances.joined([], part.smooth[view.block], len(x))
            smooth = replace(smooth, root=root)
            ranges = Measurements(view.jacobian, error, weight, smooth)
            if step < _STEPS:
                response = bubble.linearised(x, pressure, gas)
            relaxing = response.motion(friction - bubble.residual(x, pressure, gas))
            problem = ContactProblem(response, ranges, part.prior, pressure, relaxing)
            contact = problem.solve_debiased(problem.max_evidence(Selection(support)), touches)
            near = float(np.abs(contact.motion).max()) <= self._model.mesh.edge_length
            if not (near and contact.converged and contact.pressure.any()):
                return None
            x, pressure, support = x + contact.motion, contact.pressure, contact.support
            residual = error - view.jacobian @ contact.motion.ravel()
            residual -= smooth.error(contact.amplitudes)
            noise = observer.noise_factor(observation, view.block, residual, steady=True)
        return FineContact(
            finer.mesh,
            finer.ends,
            (0.25 if part.twice else 0.5) * self._model.mesh.edge_length,
            pressure,
            x - finer.mesh.nodes,
            at_noise(part.resolution_m, noise),
        )


def mesh_limits(estimator: Estimator, mean_noise: float = 1.0) -> bool:
    """Whether an estimator's mesh blurs contacts more than the noise of its camera does.

    `mean_noise`: σ of the noise of a mean of images over that of one.
    """
    resolution = at_noise(estimator.resolution_m, mean_noise)
    return resolution < _SENSOR_LIMIT * estimator.mesh.edge_length


def _effective_nodes(pressure: np.ndarray) -> float:
    """Effective number of nodes that carry a pressure, (Σp)² / Σp²."""
    return float(pressure.sum() ** 2 / (pressure @ pressure))


def _within(rings: np.ndarray, nodes: np.ndarray, count: int) -> np.ndarray:
    """Nodes (n,) bool within `count` rings of a set."""
    for _ in range(count):
        nodes = grown(rings, nodes)
    return nodes


def _smooth_errors(observer: RangeObserver) -> np.ndarray:
    """Range errors (b, 6) of the blocks of a part: polynomials of second degree over the image.

    Errors of the model around a contact, such as of the stress in an oval membrane, are smooth.
    Treated as noise they would blur the contact. Their prior is the excess of the noise factor of
    the estimated shape over the noise of the camera.
    """
    forward, *tilts = observer.image_errors[:, :3].T
    across = [tilt / np.where(forward > 0.0, forward, 1.0) for tilt in tilts]
    a, b = ((tilt - tilt.mean()) / tilt.std() for tilt in across)
    return np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], axis=1)
