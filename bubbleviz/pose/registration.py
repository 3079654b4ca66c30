"""Fits an object's surface to the membrane that touches it: robust Gauss–Newton in two stages.

Stage one uses only the contact points, which lie on the object. Stage two adds the free membrane
around them, which cannot be inside the object. `image_fit` uses the whole depth image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtri

from bubbleviz.camera import ImageErrors
from bubbleviz.inverse import at_noise
from bubbleviz.membrane import MembraneMesh, ObjectSurface, area_vectors
from bubbleviz.pose.motion import Motion, motion_between, moved, rows, way_at
from bubbleviz.result import Estimate, Patch, Stage

# Points of the estimated membrane on and around the contact.


MIN_POINTS = 12
"""Fewest contact points of a patch: two triangles of the mesh."""

_REACH_M = 0.008  # distance around the patch in which the free membrane is used

_MAX_POINTS = 160  # contact points, and free ones; more are redundant

_CENTRES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])
"""Barycentric coordinates of the centres of a triangle's four quarters."""


@dataclass(frozen=True)
class ContactPoints:
    """Points of the membrane in B, on and around the contact patch."""

    # points, normals: (k, 3), on the patch, with the membrane's outward unit normals, which oppose
    # the object's
    points: np.ndarray
    normals: np.ndarray
    areas_m2: np.ndarray  # (k,), membrane area that each represents
    pressure_pa: np.ndarray  # (k,), contact pressure
    friction_pa: np.ndarray  # (n, 3), at all nodes, on areas at rest
    free: np.ndarray  # (f, 3), around the patch, where the membrane touches nothing
    free_areas_m2: np.ndarray  # (f,)
    center: np.ndarray  # (3,), mean of `points`, weighted by area
    radius_m: float  # their root mean square distance from it
    rest_center: np.ndarray  # (3,), where that part of the membrane was at rest, on average
    membrane: np.ndarray  # (n, 3), all nodes of the membrane, as estimated
    image_errors: ImageErrors | None  # as estimated with them
    noise_factor: float  # of the image, as in `Estimate`, at least 1

    @property
    def extent_m(self) -> float:
        """Radius around the centre with 95 % of the contact points: noise puts some far away."""
        return float(np.quantile(np.linalg.norm(self.points - self.center, axis=1), 0.95))

    def rms_distance_m(self, distance_m: np.ndarray) -> float:
        """Root mean square distance from an object, for those (k,) of the contact points.

        Of the nearest 95 % of the area, as in `extent_m`.
        """
        order = np.argsort(np.abs(distance_m))
        area = np.cumsum(self.areas_m2[order])
        near = order[: np.searchsorted(area, 0.95 * area[-1]) + 1]
        return float(np.sqrt(np.average(distance_m[near] ** 2, weights=self.areas_m2[near])))

    @property
    def width_m(self) -> float:
        """Width of a strip as wide as the patch, by its moment of area across its length."""
        moments = np.cov(self.points.T, aweights=self.areas_m2)
        return float(np.sqrt(12.0 * max(np.linalg.eigvalsh(moments)[1], 0.0)))


def contact_points(mesh: MembraneMesh, estimate: Estimate, patch: Patch) -> ContactPoints | None:
    """Contact points of an estimate, on its finest mesh; None if there are too few for a pose."""
    friction = np.zeros_like(mesh.nodes) if estimate.friction_n is None else estimate.friction_n
    friction, membrane = friction / mesh.areas[:, None], mesh.deformed(estimate.motion_m)
    known, noise_factor = estimate.image_errors, max(estimate.noise_factor, 1.0)
    mesh, estimate, of_node = patch.finest(mesh, estimate)
    nodes = mesh.deformed(estimate.motion_m)
    inside = of_node > 0.0
    near = np.any(inside[mesh.triangles], axis=1)
    if not near.any():
        return None
    middle = nodes[mesh.triangles[near]].mean(axis=1)
    box = np.abs(nodes - middle.mean(axis=0)).max(axis=1)
    around = box < np.abs(middle - middle.mean(axis=0)).max() + _REACH_M + 2.0 * mesh.edge_length
    triangles = mesh.triangles[np.all(around[mesh.triangles], axis=1)]
    corners = nodes[triangles]
    vectors = area_vectors(nodes, triangles)
    areas = np.linalg.norm(vectors, axis=1)
    points = np.einsum("qj,tjk->tqk", _CENTRES, corners).reshape(-1, 3)
    level = (of_node[triangles] @ _CENTRES.T).ravel()
    pressure = (estimate.contact_pressure_pa[triangles] @ _CENTRES.T).ravel()
    on = np.flatnonzero(level > 0.0)
    if len(on) < MIN_POINTS:
        return None
    facets = vectors / areas[:, None]
    share = 0.25 * np.repeat(areas, 4)
    center = share[on] @ points[on] / share[on].sum()
    at_rest = np.einsum("qj,tjk->tqk", _CENTRES, mesh.nodes[triangles]).reshape(-1, 3)
    spread = share[on] @ np.sum((points[on] - center) ** 2, axis=1) / share[on].sum()
    off = np.flatnonzero(level <= 0.0)
    away_m, _ = cKDTree(points[on]).query(points[off], distance_upper_bound=_REACH_M)
    free = _thinned(off[np.isfinite(away_m)])
    kept = _thinned(on)
    return ContactPoints(
        points=points[kept],
        normals=facets[kept // 4],
        areas_m2=share[kept] * (share[on].sum() / share[kept].sum()),
        pressure_pa=pressure[kept],
        friction_pa=friction,
        free=points[free],
        free_areas_m2=np.full(len(free), share[on].mean()),
        center=center,
        radius_m=float(np.sqrt(spread)),
        rest_center=share[on] @ at_rest[on] / share[on].sum(),
        membrane=membrane,
        image_errors=known,
        noise_factor=noise_factor,
    )


def _thinned(index: np.ndarray) -> np.ndarray:
    """Some of the points, evenly spread in the mesh's own order."""
    return index[:: max(1, -(-len(index) // _MAX_POINTS))]


# Distance of points from the surface of an object at a pose, and its gradient.


_OVER = np.cos(np.radians(30.0))
"""Cosine between the normal at the closest place and the direction to it, above which a point is
over a face."""

_NEAR_M = 1e-3
"""Distance below which noise dominates the direction to the closest place."""


@dataclass(frozen=True)
class ObjectDistance:
    """Distances of points in B from an object at a pose."""

    signed_m: np.ndarray  # (k,), positive outside
    # gradient, normal, place: (k, 3), of the distance, of the surface at the closest place, and
    # that place, in B
    gradient: np.ndarray
    normal: np.ndarray
    place: np.ndarray
    over: np.ndarray  # (k,) bool, over a face (else outside its outline)

    def split(self, count: int) -> tuple[ObjectDistance, ObjectDistance]:
        """Distances of the first points and of the others."""
        parts = zip(*(np.split(each, [count]) for each in vars(self).values()), strict=True)
        first, rest = (ObjectDistance(*part) for part in parts)
        return first, rest


def object_distance(model: ObjectSurface, points: np.ndarray, T_B_O: np.ndarray) -> ObjectDistance:
    """Distances of points (k, 3) in B from an object at a pose (4, 4)."""
    R = T_B_O[:3, :3]
    found = model.closest((points - T_B_O[:3, 3]) @ R)
    place, normal = found.place @ R.T + T_B_O[:3, 3], found.normal @ R.T
    way = points - place
    length = np.linalg.norm(way, axis=1)
    along = np.einsum("ij,ij->i", way, normal)
    outside = along > -0.5 * length  # at an edge the normal is that of one of its faces
    over = (length < _NEAR_M) | (np.abs(along) > _OVER * length)
    sign = np.where(outside, 1.0, -1.0)
    straight = way * (sign / np.maximum(length, 1e-12))[:, None]
    return ObjectDistance(
        signed_m=np.where(over, along, sign * length),
        gradient=np.where(over[:, None], normal, straight),
        normal=normal,
        place=place,
        over=over,
    )


INLIER_M = 1.5e-3
"""A contact point this close to the object agrees with it: three σ of the estimate."""

MODEL_ERROR_M = 2.4e-4
"""Model error of the membrane's position: of the estimate, independent between areas of the size of
its resolution; of a press, between triangles of its mesh. Chosen with areas of the resolution for
both: of 0, 0.24, 0.28 and 0.4 mm the least for which ellipsoids contain at least 93 % of true poses
in each class of 280 simulated tracks. The contact determines a direction if its σ at the patch's
edge is below the error of one area."""

_ANOTHER_OBJECT = 1e-3
"""Significance at which the distance of the contact from an object tells that it is another one, or
in another pose. Of 188 frames of a cube's corner and a ball with noise of 0.15 mm and 1 %, which
were not used for this choice, 5 exceed the limit, all of the corner: the estimate rounds it off."""

_PARALLEL = np.cos(np.radians(45.0))
"""Membrane that lies on a face is parallel to it, except for the blur of the estimate."""

_AWAY = 0.3  # cosine between the normals of membrane and object beyond which they face the same way

_SLACK = 0.155
"""Penetration of the estimated membrane at an object's edges, by blur, in lengths of the estimate's
resolution: 0.5 mm for the paper's sensor."""

_EDGE_DEVIATION_M = 2e-3
"""Error of the patch's edge, where membrane without contact is classified as contact."""

_NARROWEST_M = 1e-3
_NARROWING = 0.6
"""Final scale of the robust weights, and factor of the scale per iteration."""

_CONVERGED_M = 2e-5  # step at the patch's edge that counts as converged


@dataclass(frozen=True)
class Precision:
    """Precision of the membrane's estimated position."""

    information_per_m4: float  # sum of 1/σ² of the range pixels per area of membrane
    resolution_m: float  # correlation length of the estimate's errors

    @property
    def per_area(self) -> float:
        """1/σ² of the membrane's position along its normal per area, by all errors, 1/m⁴."""
        return 1.0 / (1.0 / self.information_per_m4 + (self.resolution_m * MODEL_ERROR_M) ** 2)

    def at_noise(self, factor: float) -> Precision:
        """In an image noisier by a factor."""
        information = self.information_per_m4 / factor**2
        return Precision(information, at_noise(self.resolution_m, factor))

    @property
    def across_edge(self) -> float:
        """The same across the patch's edge, for contact points outside the object's outline."""
        return 1.0 / (self.resolution_m * _EDGE_DEVIATION_M) ** 2


@dataclass(frozen=True, kw_only=True)
class Fit(Stage):
    """A pose and how well it fits; inliers are within `INLIER_M` of the object."""

    cost: float  # robust misfit in units of the noise, squared; lower is better
    # (6, 6), information of the contact normals about small motions in B about the patch's centre
    surface: np.ndarray
    distance: ObjectDistance  # of the contact points, then of the free ones


@dataclass(frozen=True)
class _Term:
    """Normal equations of some residuals: information, gradient, and robust misfit."""

    H: np.ndarray
    g: np.ndarray
    cost: float

    @classmethod
    def of(cls, J: np.ndarray, residual: np.ndarray, weight: np.ndarray, scale: float) -> _Term:
        """Residuals (k,) with Jacobian (k, c), 1/σ² and the scale of Geman and McClure's weight."""
        trust = 1.0 / (1.0 + (residual / scale) ** 2)
        w = weight * trust**2
        return cls((J.T * w) @ J, J.T @ (w * residual), float(weight * trust @ residual**2))

    def __add__(self, other: _Term) -> _Term:
        return _Term(self.H + other.H, self.g + other.g, self.cost + other.cost)


_At = tuple[np.ndarray, ObjectDistance]  # a pose (4, 4), and the distances of all points there


class Registration:
    """Fits one object to contact points."""

    def __init__(self, model: ObjectSurface, precision: Precision) -> None:
        self.model, self.precision = model, precision

    def stage_one(
        self,
        contact: ContactPoints,
        prior: Motion,  # the fit starts at its pose
        *,
        # initial scale of the robust weights: possible error of the initial pose
        widest_m: float = 5e-3,
        iterations: int = 12,  # at most
    ) -> Fit:
        """Fit to the contact points only, weighted by their pressure."""
        share = contact.areas_m2 * contact.pressure_pa
        share *= contact.areas_m2.sum() / share.sum()
        begun = self._at(contact, prior.T_B_O)
        return self._fit(contact, share, begun, prior, widest_m, iterations, around=False)

    def stage_two(
        self,
        contact: ContactPoints,
        first: Fit,  # of stage one
        prior: Motion,
        iterations: int = 12,
    ) -> Fit:
        """Refine with the free membrane around the patch; other parameters as in `stage_one`."""
        share, begun = contact.areas_m2, (first.T_B_O, first.distance)
        return self._fit(contact, share, begun, prior, 2e-3, iterations, around=True)

    def deviation_m(self, contact: ContactPoints) -> float:
        """Expected distance of contact points from the object, root mean square."""
        precision = self.precision.at_noise(contact.noise_factor)
        return float(precision.per_area**-0.5 / precision.resolution_m)

    def distance_limit_m(self, contact: ContactPoints) -> float:
        """Root mean square distance that contact points of this object rarely exceed."""
        resolution_m = self.precision.at_noise(contact.noise_factor).resolution_m
        areas = max(float(contact.areas_m2.sum()) / resolution_m**2, 1.0)  # with independent errors
        ratio = float(chdtri(areas, _ANOTHER_OBJECT)) / areas
        return self.deviation_m(contact) * ratio**0.5

    def at(self, contact: ContactPoints, fit: Fit, T_B_O: np.ndarray) -> Fit:
        """A fit moved to another pose (4, 4)."""
        return self._finished(contact, self._at(contact, T_B_O), list(fit.history))

    def _at(self, contact: ContactPoints, T: np.ndarray) -> _At:
        points = np.concatenate([contact.points, contact.free])
        return T, object_distance(self.model, points, T)

    def _fit(
        self,
        contact: ContactPoints,
        share_m2: np.ndarray,
        begun: _At,
        prior: Motion,
        widest_m: float,
        iterations: int,
        *,
        around: bool,
    ) -> Fit:
        (T, distance), scale, known = begun, widest_m, prior.information
        history = []
        for _ in range(iterations):
            on, free = distance.split(len(contact.points))
            history.append(np.array(_agreement(contact, on)[:2]))
            total = self._surface(contact, share_m2, on, scale)
            total += self._outside(contact, share_m2, on, scale)
            if around:
                total += self._free(contact, free)
            pull = known @ motion_between(prior.T_B_O, T, contact.center)
            step = -np.linalg.solve(total.H + known, total.g + pull)
            T, distance = self._at(contact, moved(T, step, contact.center))
            converged = way_at(contact.radius_m, step) < _CONVERGED_M and scale == _NARROWEST_M
            scale = max(_NARROWING * scale, _NARROWEST_M)
            if converged:
                break
        return self._finished(contact, (T, distance), history)

    def _finished(self, contact: ContactPoints, at: _At, history: list[np.ndarray]) -> Fit:
        T, distance = at
        on, free = distance.split(len(contact.points))
        fitness, rmse, count = _agreement(contact, on)
        surface = self._surface(contact, contact.areas_m2, on, _NARROWEST_M)
        outline = self._outside(contact, contact.areas_m2, on, _NARROWEST_M)
        outline += self._free(contact, free)
        return Fit(
            T_B_O=T,
            fitness=fitness,
            rmse_m=rmse,
            correspondences=count,
            cost=surface.cost + outline.cost,
            surface=surface.H,
            distance=distance,
            history=np.array([*history, (fitness, rmse)]),
            ms=0.0,
        )

    def _surface(
        self, contact: ContactPoints, share_m2: np.ndarray, distance: ObjectDistance, scale: float
    ) -> _Term:
        """Residuals: contact points over a face lie on it."""
        facing = np.einsum("ij,ij->i", distance.normal, contact.normals)
        used = distance.over & (facing < -_PARALLEL)
        J = -rows(distance.normal[used], contact.points[used], contact.center)
        weight = self.precision.at_noise(contact.noise_factor).per_area * share_m2
        term = _Term.of(J, distance.signed_m[used], weight[used], scale)
        # Points without an opposing face of the object count as far away.
        missed = float(weight[distance.over & (facing > _AWAY)].sum()) * scale**2
        return _Term(term.H, term.g, term.cost + missed)

    def _outside(
        self, contact: ContactPoints, share_m2: np.ndarray, distance: ObjectDistance, scale: float
    ) -> _Term:
        """Residuals: the object covers contact points outside its outline, or at its sides."""
        facing = np.einsum("ij,ij->i", distance.normal, contact.normals)
        at_side = (facing >= -_PARALLEL) & (facing <= _AWAY)
        used = ~distance.over | at_side
        J = -rows(distance.gradient[used], contact.points[used], contact.center)
        weight = self.precision.at_noise(contact.noise_factor).across_edge * share_m2[used]
        return _Term.of(J, distance.signed_m[used], weight, 2.0 * scale)

    def _free(self, contact: ContactPoints, distance: ObjectDistance) -> _Term:
        """Residuals: the free membrane is not inside the object."""
        precision = self.precision.at_noise(contact.noise_factor)
        depth = np.minimum(distance.signed_m + _SLACK * precision.resolution_m, 0.0)
        used = depth < 0.0
        J = -rows(distance.gradient[used], contact.free[used], contact.center)
        weight = precision.per_area * contact.free_areas_m2[used]
        return _Term.of(J, depth[used], weight, 2.0 * _NARROWEST_M)


def _agreement(contact: ContactPoints, distance: ObjectDistance) -> tuple[float, float, int]:
    """Fitness, rmse in m and number of the contact points that agree with the object."""
    agree = np.abs(distance.signed_m) < INLIER_M
    agree &= np.einsum("ij,ij->i", distance.normal, contact.normals) < _AWAY
    areas = contact.areas_m2[agree]
    area = float(areas.sum())
    rmse = np.sqrt(areas @ distance.signed_m[agree] ** 2 / area) if area > 0.0 else np.nan
    return area / float(contact.areas_m2.sum()), float(rmse), int(np.count_nonzero(agree))


# Motions of an object that the contact does not determine.


_TURNS = 0.3
_LARGEST_RADIUS_M = 0.1
"""A motion that rotates less than this share of the largest rotation is a translation; limit of the
radius of patches."""

MIN_RADIUS_M = 2e-3  # smaller patches are treated as of this radius


@dataclass(frozen=True)
class Directions:
    """Six independent small motions, from the best determined to the least."""

    # (6, 6), in columns, in B about the patch's centre: translation, then rotation in rad, such
    # that a unit of each moves the patch's edge by about 1 m
    motions: np.ndarray
    # (6,), standard deviation of each at the patch's edge by the contact normals only
    deviation_m: np.ndarray
    determined: np.ndarray  # (6,) bool


def directions(surface: np.ndarray, radius_m: float) -> Directions:
    """Directions of the information (6, 6) of contact normals on a patch of some radius."""
    radius = max(radius_m, MIN_RADIUS_M)
    unit = np.array([1.0, 1.0, 1.0, 1.0 / radius, 1.0 / radius, 1.0 / radius])
    information, vectors = np.linalg.eigh(surface * np.outer(unit, unit))
    information, vectors = information[::-1], vectors[:, ::-1]
    with np.errstate(divide="ignore"):
        deviation = 1.0 / np.sqrt(np.maximum(information, 0.0))
    return Directions(unit[:, None] * vectors, deviation, deviation < MODEL_ERROR_M)


def open_axes(
    motions: np.ndarray,  # (6, q), columns as in `Directions.motions`
) -> tuple[np.ndarray, np.ndarray]:
    """Translations and rotations spanned by motions: unit directions (s, 3), axes (t, 3) in B.

    A combined motion, as of a ball about its centre, counts as a rotation.
    """
    if not motions.size:
        return np.zeros((0, 3)), np.zeros((0, 3))
    # The rotation part of an eigenvector has at most length 1/radius.
    vectors, sizes, mixed = np.linalg.svd(motions[3:])
    turning = _turning(sizes)
    turns = vectors.T[: len(sizes)][turning]
    still = motions @ mixed[int(turning.sum()) :].T
    shifts = still[:3] / np.maximum(np.linalg.norm(still[:3], axis=0), 1e-12)
    return shifts.T, turns


def spins(motions: np.ndarray) -> np.ndarray:
    """Combinations (6, 3) of motions (6, q) that rotate about each axis; 0 if none does."""
    vectors, sizes, mixed = np.linalg.svd(motions[3:], full_matrices=False)
    turning = _turning(sizes)
    found: np.ndarray = motions @ mixed[turning].T @ (vectors[:, turning] / sizes[turning]).T
    return found


def _turning(sizes: np.ndarray) -> np.ndarray:
    """Which motions rotate, by the sizes of their rotations, 1/m."""
    return sizes > _TURNS * max(float(sizes.max(initial=0.0)), 1.0 / _LARGEST_RADIUS_M)
