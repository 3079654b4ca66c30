"""Fits an object's surface to the membrane that touches it: robust Gauss–Newton in two stages.

Stage one takes the contact points alone: they lie on the object. Stage two adds what is around
them: the free membrane cannot be inside the object. What the whole depth image says is
left to `depth_image`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import cKDTree

from bubbleviz.membrane import MembraneMesh, ObjectSurface, area_vectors
from bubbleviz.pose.motion import motion_between, moved, rows, way_at
from bubbleviz.result import Estimate, Patch

# What the estimated membrane says about an object that touches it.


LEAST_POINTS = 12
"""Contact points below which there is no patch to speak of: two triangles of the mesh."""

_REACH_M = 0.008  # how far around the patch the free membrane is looked at

_MOST = 160  # contact points, and free ones, beyond which more of them say the same again

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
    free: np.ndarray  # (f, 3), around the patch, where the membrane touches nothing
    free_areas_m2: np.ndarray  # (f,)
    center: np.ndarray  # (3,), mean of `points`, weighted by area
    radius_m: float  # their root mean square distance from it
    rest_center: np.ndarray  # (3,), where that part of the membrane was at rest, on average
    membrane: np.ndarray  # (n, 3), all nodes of the membrane, as estimated

    @property
    def extent_m(self) -> float:
        """Largest distance of a contact point from the centre."""
        return float(np.linalg.norm(self.points - self.center, axis=1).max())


def contact_points(mesh: MembraneMesh, estimate: Estimate, patch: Patch) -> ContactPoints | None:
    """Contact points of an estimate; None where the patch has fewer than a pose needs."""
    nodes = mesh.deformed(estimate.motion_m)
    inside = patch.level > 0.0
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
    level = (patch.level[triangles] @ _CENTRES.T).ravel()
    pressure = (estimate.contact_pressure_pa[triangles] @ _CENTRES.T).ravel()
    on = np.flatnonzero(level > 0.0)
    if len(on) < LEAST_POINTS:
        return None
    facets = vectors / areas[:, None]
    share = 0.25 * np.repeat(areas, 4)
    center = share[on] @ points[on] / share[on].sum()
    at_rest = np.einsum("qj,tjk->tqk", _CENTRES, mesh.nodes[triangles]).reshape(-1, 3)
    spread = share[on] @ np.sum((points[on] - center) ** 2, axis=1) / share[on].sum()
    off = np.flatnonzero(level <= 0.0)
    free = _thinned(off[_within(points[off], points[on], _REACH_M)])
    kept = _thinned(on)
    return ContactPoints(
        points=points[kept],
        normals=facets[kept // 4],
        areas_m2=share[kept] * (share[on].sum() / share[kept].sum()),
        pressure_pa=pressure[kept],
        free=points[free],
        free_areas_m2=np.full(len(free), share[on].mean()),
        center=center,
        radius_m=float(np.sqrt(spread)),
        rest_center=share[on] @ at_rest[on] / share[on].sum(),
        membrane=nodes,
    )


def _thinned(index: np.ndarray) -> np.ndarray:
    """Some of the points, evenly spread in the mesh's own order."""
    return index[:: max(1, -(-len(index) // _MOST))]


def _within(points: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:
    """Which points (k, 3) have one of the others closer than `reach`."""
    distance, _ = cKDTree(others).query(points, distance_upper_bound=reach)
    return np.isfinite(distance)


# How far points are from the surface of an object at a pose, and which way that changes.


_OVER = np.cos(np.radians(30.0))
"""Cosine between the way to the closest place and the normal there, for a point over a face and
not beside it."""

_NEAR_M = 1e-3
"""Distance below which noise decides on the direction of the way to the closest place."""


@dataclass(frozen=True)
class ObjectDistance:
    """Points in B against an object at a pose."""

    signed_m: np.ndarray  # (k,), positive outside
    # gradient, normal, place: (k, 3), of the distance, of the surface at the closest place, and
    # that place, in B
    gradient: np.ndarray
    normal: np.ndarray
    place: np.ndarray
    over: np.ndarray  # (k,) bool, over a face, not beside it

    def of(self, some: slice) -> ObjectDistance:
        """Of some of the points."""
        return ObjectDistance(*(getattr(self, field.name)[some] for field in fields(self)))


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
"""A contact point this close to the object agrees with it: three deviations of the estimate."""

_MODEL_ERROR_M = 4e-4
"""Error of the membrane's place that is not noise, independent from one patch of the size of the
estimate's resolution to the next."""

_PARALLEL = np.cos(np.radians(45.0))
"""Membrane that lies on a face is parallel to it, but for the blur of the estimate."""

_AWAY = 0.3  # cosine between the normals of membrane and object beyond which they face the same way

_SLACK_M = 5e-4  # how far blur takes the estimated membrane into an object's edges

_EDGE_DEVIATION_M = 2e-3
"""Error of the patch's edge, where membrane is taken for contact that is none."""

_NARROWEST_M = 1e-3
_NARROWING = 0.6
"""Residual at which robust weights begin to fall in the end, and how fast it gets there."""

_CONVERGED_M = 2e-5  # step at the patch's edge that is none


@dataclass(frozen=True)
class Precision:
    """How precisely the estimate knows where the membrane is."""

    information_per_m4: float  # sum of 1/σ² of the range pixels per area of membrane
    resolution_m: float  # distance over which the estimate's errors are one

    @property
    def of_model(self) -> float:
        """1/σ² of the membrane's place along its normal per area, but for noise, 1/m⁴."""
        return 1.0 / (self.resolution_m * _MODEL_ERROR_M) ** 2

    @property
    def per_area(self) -> float:
        """1/σ² of the membrane's place along its normal per area, model errors included, 1/m⁴."""
        return 1.0 / (1.0 / self.information_per_m4 + 1.0 / self.of_model)

    @property
    def beside(self) -> float:
        """The same across the patch's edge, for membrane that should not be beside the object."""
        return 1.0 / (self.resolution_m * _EDGE_DEVIATION_M) ** 2


@dataclass(frozen=True)
class Prior:
    """What is known of the pose before a frame."""

    T_B_O: np.ndarray  # (4, 4)
    # (6, 6), inverse covariance of small motions in B about the patch's centre
    information: np.ndarray


@dataclass(frozen=True)
class Fit:
    """A pose and how well it fits."""

    T_B_O: np.ndarray  # (4, 4)
    fitness: float  # share of the patch within `INLIER_M` of the object, 0 to 1
    rmse_m: float  # root mean square distance of that share; NaN where there is none
    correspondences: int  # number of contact points in that share
    cost: float  # robust misfit in units of the noise, squared; lower is better
    # (6, 6), information of the contact normals about small motions in B about the patch's centre
    surface: np.ndarray
    # (6, 6), information of all else: points beside the object and the free membrane, about shifts
    # alone
    outline: np.ndarray
    looked: ObjectDistance  # of the contact points, then of the free ones
    history: np.ndarray  # (i, 2), fitness, and rmse in m, at the start and after every iteration


@dataclass(frozen=True)
class _Term:
    """Normal equations of some residuals: information, gradient, and robust misfit."""

    H: np.ndarray
    g: np.ndarray
    cost: float

    @classmethod
    def of(cls, J: np.ndarray, residual: np.ndarray, weight: np.ndarray, scale: float) -> _Term:
        """Residuals (k,) of Jacobian (k, c), each with 1/σ² and the scale of its robust weight.

        Geman and McClure's: what is far beyond the scale hardly counts.
        """
        trust = 1.0 / (1.0 + (residual / scale) ** 2)
        w = weight * trust**2
        return cls((J.T * w) @ J, J.T @ (w * residual), float(weight * trust @ residual**2))

    def __add__(self, other: _Term) -> _Term:
        return _Term(self.H + other.H, self.g + other.g, self.cost + other.cost)


_SHIFTS = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""Where a point beside the object is off to is half noise: turns cannot be told from it."""


_Looked = tuple[np.ndarray, ObjectDistance]
"""A pose (4, 4) with the contact points and the free ones against the object there."""


class Registration:
    """Fits one object to contact points."""

    def __init__(self, model: ObjectSurface, precision: Precision) -> None:
        self.model, self.precision = model, precision

    def stage_one(
        self,
        contact: ContactPoints,
        start: np.ndarray,  # (4, 4), T_B_O at which to begin
        prior: Prior,  # decides where the contact does not
        *,
        # scale of the robust weights at first: how far off the start may be
        widest_m: float = 5e-3,
        iterations: int = 12,  # at most
    ) -> Fit:
        """Fit to the contact points alone, weighted by the pressure on them."""
        share = contact.areas_m2 * contact.pressure_pa
        share *= contact.areas_m2.sum() / share.sum()
        begun = self._at(contact, start)
        return self._fit(contact, share, begun, prior, widest_m, iterations, around=False)

    def stage_two(
        self,
        contact: ContactPoints,
        first: Fit,  # of stage one
        prior: Prior,
        *,
        widest_m: float = 2e-3,
        iterations: int = 12,
    ) -> Fit:
        """Refine with the free membrane around the patch; other parameters as in `stage_one`."""
        share, begun = contact.areas_m2, (first.T_B_O, first.looked)
        return self._fit(contact, share, begun, prior, widest_m, iterations, around=True)

    def misfit(self, contact: ContactPoints, T_B_O: np.ndarray) -> float:
        """Robust misfit of a pose (4, 4) by all that stage two looks at, in units of the noise."""
        return self._finished(contact, self._at(contact, T_B_O), []).cost

    def at(self, contact: ContactPoints, fit: Fit, T_B_O: np.ndarray) -> Fit:
        """A fit moved to another pose (4, 4)."""
        return self._finished(contact, self._at(contact, T_B_O), list(fit.history))

    def _at(self, contact: ContactPoints, T: np.ndarray) -> _Looked:
        points = np.concatenate([contact.points, contact.free])
        return T, object_distance(self.model, points, T)

    def _fit(
        self,
        contact: ContactPoints,
        share_m2: np.ndarray,
        begun: _Looked,
        prior: Prior,
        widest_m: float,
        iterations: int,
        *,
        around: bool,
    ) -> Fit:
        (T, looked), scale = begun, widest_m
        history = []
        for _ in range(iterations):
            on, free = _parted(contact, looked)
            history.append(np.array(_agreement(contact, on)[:2]))
            total = self._surface(contact, share_m2, on, scale)
            total += self._beside(contact, share_m2, on, scale)
            if around:
                total += self._free(contact, free)
            pull = prior.information @ motion_between(prior.T_B_O, T, contact.center)
            step = -np.linalg.solve(total.H + prior.information, total.g + pull)
            T, looked = self._at(contact, moved(T, step, contact.center))
            settled = way_at(contact.radius_m, step) < _CONVERGED_M and scale == _NARROWEST_M
            scale = max(_NARROWING * scale, _NARROWEST_M)
            if settled:
                break
        return self._finished(contact, (T, looked), history)

    def _finished(self, contact: ContactPoints, at: _Looked, history: list[np.ndarray]) -> Fit:
        T, looked = at
        on, free = _parted(contact, looked)
        fitness, rmse, count = _agreement(contact, on)
        surface = self._surface(contact, contact.areas_m2, on, _NARROWEST_M)
        outline = self._beside(contact, contact.areas_m2, on, _NARROWEST_M)
        outline += self._free(contact, free)
        return Fit(
            T_B_O=T,
            fitness=fitness,
            rmse_m=rmse,
            correspondences=count,
            cost=surface.cost + outline.cost,
            surface=surface.H,
            outline=_SHIFTS @ outline.H @ _SHIFTS,
            looked=looked,
            history=np.array([*history, (fitness, rmse)]),
        )

    def _surface(
        self, contact: ContactPoints, share_m2: np.ndarray, distance: ObjectDistance, scale: float
    ) -> _Term:
        """Contact points over a face lie on it."""
        facing = np.einsum("ij,ij->i", distance.normal, contact.normals)
        used = distance.over & (facing < -_PARALLEL)
        J = -rows(distance.normal[used], contact.points[used], contact.center)
        weight = self.precision.per_area * share_m2
        term = _Term.of(J, distance.signed_m[used], weight[used], scale)
        # Points that no face of the object looks at count as far away.
        missed = float(weight[distance.over & (facing > _AWAY)].sum()) * scale**2
        return _Term(term.H, term.g, term.cost + missed)

    def _beside(
        self, contact: ContactPoints, share_m2: np.ndarray, distance: ObjectDistance, scale: float
    ) -> _Term:
        """Contact points beside the object, or at its sides, draw it over themselves."""
        facing = np.einsum("ij,ij->i", distance.normal, contact.normals)
        beside = (facing >= -_PARALLEL) & (facing <= _AWAY)
        used = ~distance.over | beside
        J = -rows(distance.gradient[used], contact.points[used], contact.center)
        weight = self.precision.beside * share_m2[used]
        return _Term.of(J, distance.signed_m[used], weight, 2.0 * scale)

    def _free(self, contact: ContactPoints, distance: ObjectDistance) -> _Term:
        """The free membrane is not inside the object."""
        depth = np.minimum(distance.signed_m + _SLACK_M, 0.0)
        used = depth < 0.0
        J = -rows(distance.gradient[used], contact.free[used], contact.center)
        weight = self.precision.per_area * contact.free_areas_m2[used]
        return _Term.of(J, depth[used], weight, 2.0 * _NARROWEST_M)


def _parted(
    contact: ContactPoints, looked: ObjectDistance
) -> tuple[ObjectDistance, ObjectDistance]:
    """Contact points and free points that were compared."""
    count = len(contact.points)
    return looked.of(slice(count)), looked.of(slice(count, None))


def _agreement(contact: ContactPoints, distance: ObjectDistance) -> tuple[float, float, int]:
    """Fitness, rmse in m and number of the contact points that agree with the object."""
    agree = np.abs(distance.signed_m) < INLIER_M
    agree &= np.einsum("ij,ij->i", distance.normal, contact.normals) < _AWAY
    areas = contact.areas_m2[agree]
    area = float(areas.sum())
    rmse = np.sqrt(areas @ distance.signed_m[agree] ** 2 / area) if area > 0.0 else np.nan
    return area / float(contact.areas_m2.sum()), float(rmse), int(np.count_nonzero(agree))


# Which ways an object can move without the contact noticing.


DETERMINED_M = 4e-4
"""Standard deviation at the patch's edge below which contact determines a direction: better than
one patch of the size of the estimate's resolution alone, whose model error this is."""

_TURNS = 0.3
_LARGEST_RADIUS_M = 0.1
"""A motion that turns less than this share of the one that turns most is a shift; patches are
smaller than this."""

LEAST_RADIUS_M = 2e-3  # a smaller patch turns about itself as one of this radius does


@dataclass(frozen=True)
class Directions:
    """Six independent small motions, from the best determined to the least."""

    # (6, 6), in columns, in B about the patch's centre: translation, then rotation in rad, such
    # that a unit of each moves the patch's edge by about 1 m
    motions: np.ndarray
    # (6,), standard deviation of each at the patch's edge by the contact normals alone
    deviation_m: np.ndarray
    determined: np.ndarray  # (6,) bool

    @property
    def open(self) -> np.ndarray:
        """The motions that the contact does not determine, (6, q)."""
        return self.motions[:, ~self.determined]


def directions(surface: np.ndarray, radius_m: float) -> Directions:
    """Directions of the information (6, 6) of contact normals on a patch of some radius."""
    radius = max(radius_m, LEAST_RADIUS_M)
    unit = np.array([1.0, 1.0, 1.0, 1.0 / radius, 1.0 / radius, 1.0 / radius])
    information, vectors = np.linalg.eigh(surface * np.outer(unit, unit))
    information, vectors = information[::-1], vectors[:, ::-1]
    with np.errstate(divide="ignore"):
        deviation = 1.0 / np.sqrt(np.maximum(information, 0.0))
    return Directions(unit[:, None] * vectors, deviation, deviation < DETERMINED_M)


def open_axes(
    motions: np.ndarray,  # (6, q), columns as in `Directions.motions`
) -> tuple[np.ndarray, np.ndarray]:
    """Shifts and turns among some motions: unit directions (s, 3) and axes (t, 3) in B.

    Where a turn comes with a shift, as a ball's about its middle, the turn counts.
    """
    if not motions.size:
        return np.zeros((0, 3)), np.zeros((0, 3))
    # An eigenvector's turning part is 1/radius long at most: larger singular values are turns.
    vectors, sizes, mixed = np.linalg.svd(motions[3:])
    turning = sizes > _TURNS * max(float(sizes.max()), 1.0 / _LARGEST_RADIUS_M)
    turns = vectors.T[: len(sizes)][turning]
    still = motions @ mixed[int(turning.sum()) :].T
    shifts = still[:3] / np.maximum(np.linalg.norm(still[:3], axis=0), 1e-12)
    return shifts.T, turns
