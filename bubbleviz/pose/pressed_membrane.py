"""Exact membrane under an object at a given pose, and its derivative by the pose.

Points of the object that are inside the membrane push it outward:

    ∂W/∂x − p(V) ∂V/∂x − f_rest = Σ f_j b_j n_j + t,   f_j = k_j × depth of point j.

Friction t is that of the estimate. Its change by the object's motion is not part of the derivative.

Newton's method starts from the membrane of the last pose, in a `Submodel` around the contact; the
last tangent also gives the derivative by the object's motion. An edge that moves over the membrane
takes its load along, so that sliding of a flat face in its own plane is observable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from bubbleviz.membrane import (
    Gas,
    HeldPressure,
    ObjectSurface,
    RubberMembrane,
    Submodel,
    Tangent,
    TriangleScene,
    cross,
    midway,
    sums_at,
)
from bubbleviz.pose.motion import motion_between, rows
from bubbleviz.pose.registration import ContactPoints, directions, spins


@dataclass(frozen=True)
class PressOptions:
    """How finely an object is pressed into the membrane."""

    # distance around the patch in which the mesh is twice as fine; 0: nowhere
    finer_m: float = 0.0
    # Newton step that counts as converged: a step of 0.5 mm leaves an error of its square over the
    # size of a triangle, less than 0.1 mm
    converged_m: float = 5e-4
    # limit for one pose; from the estimated membrane some four are needed
    max_steps: int = 10


# Contact of an object with the membrane: points of the object against triangles of the membrane.
#
# Points of the object, not nodes of the membrane, are in contact, so that the edge of a face may be
# anywhere on a triangle, and the contact depends smoothly on the pose.


_SPACING_EDGES = 0.25
"""Spacing of the object's points, in edges of the mesh. Several points share a triangle, and edges
of the object, where points are twice as dense, move from one triangle to the next without a jump.
On roundings as narrow as a triangle, a spacing of half an edge made poses of pucks 0.1 to 0.3 mm
wrong."""
_SOFTNESS_M = 2e-5
"""Penetration of a face under twice the gauge pressure, and of an edge under the mean tension: far
below depth noise, yet not stiffer than the membrane's own triangles, so that Newton's method
converges without a line search."""
_MAX_DEPTH_M = 6e-3  # inside the membrane, beyond which a point is on the far side of the object
_MAX_COSINE = -0.5
"""Cosine between the direction in which a point pushes and the membrane's normal, below which it is
in contact. Beyond 60° the closest membrane is beside the point: by rounding errors, a point of a
wall in the air above the membrane would count as inside it."""
_MAX_STEP_M = 3e-3  # of Newton's method: the size of a triangle, beyond which the contact changes
_TRIES, _NEAR = 30, 10
_MAX_TRIES = 200_000  # random points for each one kept, and in a square of a rounding; in total
ROUNDING_M = 1e-3
"""Radius of the object's edges in the model: objects are rounded there, the membrane has a
thickness, and its triangles cannot follow a rounding narrower than themselves. Of the truths of
`refined_press` for a bar and a cross, whose edges have 0.5 mm, it was 1.2 ± 0.2 mm."""
_SHARPEST = 0.05
"""Lower limit of (1 + cos(angle between the normals of an edge))/2: sharper edges are treated as
edges of 26°, as rounding would move their tip too far back."""


def contact_samples(model: ObjectSurface, spacing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 3) in O about `spacing_m` apart, half that along creases, and normals (k, 2, 3).

    Along a crease the two normals are those of its faces, elsewhere they are the same.
    """
    count = min(_MAX_TRIES, int(_TRIES * model.area_m2 / spacing_m**2) + _TRIES)
    points, single = model.sample(count)
    normals = np.repeat(single[:, None], 2, axis=1)
    if model.creases is None:
        kept = _thinned(points, spacing_m)
        return points[kept], normals[kept]
    edge = np.asarray(model.creases.tree.data)
    near = 0.5 * spacing_m
    clear = np.isinf(model.creases.tree.query(points, distance_upper_bound=near)[0])
    points, normals = points[clear], normals[clear]
    kept, along = _thinned(points, spacing_m), _thinned(edge, 0.5 * spacing_m)
    return (
        np.concatenate([edge[along], points[kept]]),
        np.concatenate([model.creases.normals[along], normals[kept]]),
    )


def _thinned(points: np.ndarray, spacing_m: float) -> np.ndarray:
    """Indices of one point for each cube of a grid, the one closest to its centre."""
    cube = np.floor(points / spacing_m)
    off = np.sum((points / spacing_m - cube - 0.5) ** 2, axis=1)
    order = np.lexsort((off, *cube.T))
    new = np.any(np.diff(cube[order], axis=0) != 0.0, axis=1)
    return order[np.concatenate([np.ones(min(1, len(order)), bool), new])]


def _cores(model: ObjectSurface, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Vectors (k, 3) from the centre of a rounding of unit radius to points (k, 3) of the surface.

    On flat faces this is the unit normal; at a sharp edge it is longer, and in between where an
    edge is rounded already. It follows from the mean of the normals: of the two (k, 2, 3) at a
    sharp edge, elsewhere of those around the point.
    """
    mean = normals.mean(axis=1)
    count = min(_MAX_TRIES, int(_NEAR * model.area_m2 / ROUNDING_M**2) + _NEAR)
    near, own = model.sample(count)
    pair = cKDTree(points).sparse_distance_matrix(cKDTree(near), ROUNDING_M, output_type="ndarray")
    i, around = pair["i"], own[pair["j"]]
    alike = np.einsum("ij,ij->i", normals[i, 0], around) > 1e-6
    alike &= np.all(normals[i, 0] == normals[i, 1], axis=1)
    for axis in range(3):
        mean[:, axis] += np.bincount(i[alike], around[alike, axis], len(points))
    mean /= 1.0 + np.bincount(i[alike], minlength=len(points))[:, None]
    core: np.ndarray = mean / np.maximum(np.einsum("ij,ij->i", mean, mean), _SHARPEST)[:, None]
    return core


@dataclass(frozen=True)
class Touching:
    """Points of the object in contact with the membrane."""

    which: np.ndarray  # (c,) int, indices among all points of the object
    points: np.ndarray  # (c, 3), in B
    triangle: np.ndarray  # (c,) int, of the membrane, the one below each
    corners: np.ndarray  # (c, 3) int, its nodes
    weights: np.ndarray  # (c, 3), barycentric coordinates there
    # (c, 3), direction in which the object pushes the membrane, out of the object: that of a face,
    # on an edge the membrane's, limited to the cone of the normals of both faces
    normals: np.ndarray
    faces: np.ndarray  # (2, c, 3), normals of both faces at an edge, elsewhere twice the same
    force_n: np.ndarray  # (c,), contact force; negative if tensile
    # (c, 3, 3), derivative of that force on each corner by motion of the point over the triangle:
    # the penetration changes, and the load passes from corner to corner
    slopes_n_per_m: np.ndarray
    edge: np.ndarray  # (c,) bool, on an edge of the object
    # (c, 3), derivative of the points by the edge radius; 0 on flat faces. The centre of a rounding
    # is at a distance of its radius inside both faces, and the pushing point that far from there.
    rounding: np.ndarray

    def push(self, count: int) -> np.ndarray:
        """Forces on the nodes (count, 3)."""
        forces = self.force_n[:, None] * self.normals
        shares = self.weights[:, :, None] * forces[:, None]
        return sums_at(self.corners.ravel(), shares.reshape(-1, 3), count)

    def pulled_along(self, motions: np.ndarray, count: int) -> np.ndarray:
        """Change of the forces on the nodes (count, 3) as the points move by motions (c, 3)."""
        shares = np.einsum("caj,cj->ca", self.slopes_n_per_m, motions)
        pulls = shares[:, :, None] * self.normals[:, None]
        return sums_at(self.corners.ravel(), pulls.reshape(-1, 3), count)

    def stiffness(self) -> np.ndarray:
        """Stiffness (c, 9, 9) of the contacts by motions of their corners; not symmetric."""
        each = np.einsum("ci,caj,cb->caibj", self.normals, self.slopes_n_per_m, self.weights)
        return each.reshape(-1, 9, 9)


class ObjectContact:
    """Finds where one object touches a membrane whose nodes move."""

    def __init__(
        self,
        model: ObjectSurface,
        spacing_m: float,  # distance of the points on the object
        # pressure_pa, tension_n_per_m: loads under which faces and edges penetrate by the softness
        pressure_pa: float,
        tension_n_per_m: float,
    ) -> None:
        self._points, self._normals = contact_samples(model, spacing_m)
        self._edge = np.any(self._normals[:, 0] != self._normals[:, 1], axis=1)
        self._core = _cores(model, self._points, self._normals)
        face, edge = pressure_pa * spacing_m**2, tension_n_per_m * 0.5 * spacing_m
        self._stiffness = np.where(self._edge, edge, face) / _SOFTNESS_M
        self.reset()

    def reset(self) -> None:
        """Reset the active set and expected forces."""
        self._active = np.zeros(len(self._points), bool)
        self._expected_n = np.zeros(len(self._points))

    def expect(self, touching: Touching, motion: np.ndarray) -> None:
        """Set as active the points that push after a motion (n, 3) of the nodes, to first order.

        Second-order terms lift the membrane off a face by more than the penetration. A tangent
        without these contacts would move the membrane through the object (primal-dual active set).
        The tangent uses the forces expected after the motion, as present forces of stiff points are
        far off before convergence; after a long motion it uses none, as they would be too large.
        """
        way = np.einsum("ca,cai->ci", touching.weights, motion[touching.corners])
        force_n = touching.force_n - np.einsum("caj,cj->c", touching.slopes_n_per_m, way)
        short = np.abs(motion).max() < 0.5 * _MAX_STEP_M
        self._active[:], self._expected_n[:] = False, 0.0
        self._active[touching.which] = force_n > 0.0
        self._expected_n[touching.which] = np.maximum(force_n, 0.0) * short

    def touching(self, x: np.ndarray, triangles: np.ndarray, T_B_O: np.ndarray) -> Touching:
        """Active points, and those inside the membrane of nodes x (n, 3), triangles (m, 3)."""
        R = T_B_O[:3, :3]
        places = x[triangles]
        vectors = cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
        points = self._points @ R.T + T_B_O[:3, 3]
        below = (points[:, 2] > x[:, 2].min() - _MAX_DEPTH_M) & _below(points, places)
        close = np.flatnonzero(below | self._active)
        if not len(close):
            close = np.zeros(1, int)  # any one, as a placeholder: it is too far away to touch
        found = TriangleScene(x, triangles).closest(points[close])
        corners, weights = triangles[found.triangle], found.barycentric
        smooth = sums_at(triangles.ravel(), np.repeat(vectors, 3, axis=0), len(x))
        smooth = np.einsum("ci,cij->cj", weights, smooth[corners])
        smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
        normals = self._normals[close] @ R.T
        edge, pushing = self._edge[close], normals[:, 0].copy()
        pushing[edge] = _limited_to_cone(normals[edge], -smooth[edge])
        facing = np.einsum("cj,cj->c", smooth, pushing) < _MAX_COSINE
        way = np.einsum("ci,cij->cj", weights, x[corners]) - points[close]
        depth, length = -np.einsum("ij,ij->i", way, pushing), np.linalg.norm(way, axis=1)
        touched = (depth > 0.0) | self._active[close]
        inside = np.flatnonzero(touched & facing & (length < _MAX_DEPTH_M))
        kept, corners, pushing = close[inside], corners[inside], pushing[inside]
        force_n, weights = self._stiffness[kept] * depth[inside], weights[inside]
        sinking = self._stiffness[kept, None] * pushing
        slopes = weights[:, :, None] * sinking[:, None]
        slopes += self._expected_n[kept, None, None] * _gradients(x[corners])
        return Touching(
            which=kept,
            points=points[kept],
            triangle=found.triangle[inside],
            corners=corners,
            weights=weights,
            normals=pushing,
            faces=normals[inside].swapaxes(0, 1),
            force_n=force_n,
            slopes_n_per_m=slopes,
            edge=self._edge[kept],
            rounding=pushing - self._core[kept] @ R.T,
        )


def _below(points: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Points (k,) bool that may be below triangles (m, 3, 3): all that are, and few that are not.

    A bubble is below its membrane. In a grid of squares as wide as the widest triangle, triangles
    above a point have their corners in the square of the point or in a neighbour.
    """
    flat, width = places[:, :, :2], np.ptp(places[:, :, :2], axis=1).max()
    low = flat.min(axis=(0, 1)) - 1.5 * width
    shape = np.ceil((flat.max(axis=(0, 1)) - low) / width + 2.0).astype(int)
    highest = np.full(shape, -np.inf)
    corner = ((flat - low) / width).astype(int)
    np.maximum.at(highest, (corner[..., 0], corner[..., 1]), places[:, :, 2])
    highest = ndimage.maximum_filter(highest, 3)
    square = np.clip((points[:, :2] - low) / width, 0, shape - 1).astype(int)
    return np.asarray(points[:, 2] < highest[square[:, 0], square[:, 1]])


def _limited_to_cone(normals: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Unit vectors (k, 3) closest to the wanted ones in the cones of two unit vectors (k, 2, 3)."""
    first, second = normals[:, 0], normals[:, 1]
    c, a, b = (np.einsum("ij,ij->i", *pair) for pair in
               ((first, second), (wanted, first), (wanted, second)))  # fmt: skip
    by_first, by_second = np.maximum(a - c * b, 0.0), np.maximum(b - c * a, 0.0)
    none = by_first + by_second == 0.0
    by_first[none], by_second[none] = 1.0, 1.0
    mixed = by_first[:, None] * first + by_second[:, None] * second
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def _gradients(places: np.ndarray) -> np.ndarray:
    """Gradients (c, 3, 3) of the barycentric coordinates of triangles (c, 3, 3), by corner, 1/m."""
    opposite = np.roll(places, -2, axis=1) - np.roll(places, -1, axis=1)
    vectors = cross(opposite[:, 2], -opposite[:, 1])
    scaled = vectors / np.einsum("ij,ij->i", vectors, vectors)[:, None]
    return np.stack([cross(scaled, opposite[:, corner]) for corner in range(3)], axis=1)


@dataclass(frozen=True)
class Press:
    """An object pressed into the membrane."""

    T_B_O: np.ndarray  # (4, 4)
    center: np.ndarray  # (3,), of the motions
    part: Submodel  # part of the membrane around the contact
    nodes: np.ndarray  # (k, 3), of that part
    # (6, k, 3), their derivatives by small motions of the object in B about the centre
    slopes: np.ndarray
    seen: np.ndarray  # (6, 6), removes motions of the surface in itself from such a motion
    rounding: np.ndarray  # (k, 3), their derivative by the radius of the object's edges
    push_n: np.ndarray  # (k, 3), force of the object on each node
    # (m,) bool, triangles that faces of the object touch near all three corners, and no edge
    on_face: np.ndarray
    tangent: Tangent
    friction_n: np.ndarray  # (k, 3), of the estimate, on each node
    gas_pa: float  # measured absolute pressure; not finite: by the gas law

    @property
    def released(self) -> np.ndarray:
        """Nodes (k, 3) of the membrane around the object with rounded edges."""
        return self.nodes + ROUNDING_M * self.rounding

    def motion_by(self, contact: ContactPoints, gas_pressure_pa: float | None) -> np.ndarray:
        """Motion (k, 3) of the nodes by changes of friction and measured gas pressure since."""
        forces = _friction(self.part, contact) - self.friction_n
        change_pa = _known(gas_pressure_pa) - self.gas_pa
        if np.isfinite(change_pa):
            forces[self.tangent.moving] += change_pa * self.tangent.gas.reshape(-1, 3)
        return self.tangent.moved(forces[None])[0]


_REACH_M = 8e-3
"""Distance around the patch in which the membrane is solved exactly. Further away it turns by a few
degrees, and linear equations have errors of 0.01 to 0.04 mm."""
_MARGIN_M = 8e-3  # added, so that the contact may move that far before another part is solved


class PressedMembrane:
    """Presses one object into a membrane at successive poses."""

    def __init__(
        self,
        membrane: RubberMembrane,
        gas: Gas,
        model: ObjectSurface,
        options: PressOptions = PressOptions(),
    ) -> None:
        self.mesh = membrane.mesh
        self._membrane, self._gas, self._options = membrane, gas, options
        self._object = ObjectContact(
            model,
            _SPACING_EDGES * self.mesh.edge_length,
            2.0 * membrane.gauge_pressure_pa,
            membrane.mean_tension,
        )
        self._part: Submodel | None = None
        self.reset()

    def reset(self) -> None:
        """Start the next press from the estimated membrane."""
        self._last: Press | None = None
        self._object.reset()

    def press(
        self,
        T_B_O: np.ndarray,  # (4, 4)
        contact: ContactPoints,  # where to look for contact, and the membrane to begin with
        gas_pressure_pa: float | None = None,  # absolute; default: by the gas law
    ) -> Press | None:
        """Press the object at a pose (4, 4); None if no equilibrium is found."""
        part, gas_pa = self._around(contact), _known(gas_pressure_pa)
        if self._last is not None:
            motion = motion_between(self._last.T_B_O, T_B_O, self._last.center)
            step = self._limited(np.einsum("q,qni->ni", motion, self._last.slopes))
            start = self._last.nodes + step
            self._last = self._solve(part, start, T_B_O, contact, gas_pa)
        if self._last is None:
            self._object.reset()
            estimated = midway(contact.membrane, part.ends)
            start = np.where(part.mesh.rim[:, None], part.mesh.nodes, estimated)
            self._last = self._solve(part, start, T_B_O, contact, gas_pa)
        return self._last

    def _around(self, contact: ContactPoints) -> Submodel:
        """Part of the membrane around the contact; replaced when the contact leaves it."""
        middle, extent_m, finer_m = contact.rest_center, contact.extent_m, self._options.finer_m
        if self._part is None or not self._part.covers(middle, extent_m + _REACH_M):
            finer_m += (extent_m + _MARGIN_M) * (finer_m > 0.0)
            reach_m = extent_m + _REACH_M + _MARGIN_M
            self._part = Submodel(self._membrane, middle, reach_m, finer_m)
            self.reset()
        return self._part

    def _solve(
        self,
        part: Submodel,
        x: np.ndarray,
        T_B_O: np.ndarray,
        contact: ContactPoints,
        gas_pa: float,
    ) -> Press | None:
        """Newton's method from nodes x (k, 3)."""
        measured, friction_n = np.isfinite(gas_pa), _friction(part, contact)
        gas = HeldPressure(gas_pa - self._gas.P0) if measured else self._gas
        for _ in range(self._options.max_steps):
            if not np.isfinite(x).all():
                return None
            touching = self._object.touching(x, part.mesh.triangles, T_B_O)
            forces = touching.push(len(x)) + friction_n
            try:
                tangent, missed = part.linearised(
                    x, forces, touching.triangle, touching.stiffness(), gas
                )
            except RuntimeError:  # singular
                return None
            step = self._limited(tangent.moved(missed[None])[0])
            self._object.expect(touching, step)
            x = x + step
            if np.abs(step).max() < self._options.converged_m:
                return _pressed(part, x, T_B_O, contact, touching, tangent, friction_n, gas_pa)
        return None

    def _limited(self, step: np.ndarray) -> np.ndarray:
        """A step (k, 3) of the nodes, shortened to the longest one allowed."""
        longest_m = float(np.abs(step).max())
        return step * min(1.0, _MAX_STEP_M / max(longest_m, 1e-300))


def _friction(part: Submodel, contact: ContactPoints) -> np.ndarray:
    """Forces (k, 3) of the estimate's friction on the nodes of a part."""
    friction_n: np.ndarray = midway(contact.friction_pa, part.ends) * part.mesh.areas[:, None]
    return friction_n


def _known(gas_pressure_pa: float | None) -> float:
    return np.nan if gas_pressure_pa is None else gas_pressure_pa


_SLIDING = np.sin(np.radians(1.0))
"""Share of a motion that is normal to the object's surface, root mean square over the contact,
below which the surface counts as sliding in itself: the accuracy of normals interpolated between
facets."""


def _pressed(
    part: Submodel,
    x: np.ndarray,
    T_B_O: np.ndarray,
    contact: ContactPoints,
    touching: Touching,
    tangent: Tangent,
    friction_n: np.ndarray,
    gas_pa: float,
) -> Press:
    n, center, triangles = len(x), contact.center, part.mesh.triangles
    unit, arms = np.eye(3), touching.points - center
    motions = [np.broadcast_to(axis, arms.shape) for axis in unit]
    motions += [np.cross(axis, arms) for axis in unit]
    motions.append(touching.rounding)
    pulls = np.stack([touching.pulled_along(motion, n) for motion in motions])
    reached = np.zeros(triangles.shape, bool)
    reached[touching.triangle, touching.weights.argmax(axis=1)] = True
    reached[touching.triangle[touching.edge]] = False
    slopes = tangent.moved(pulls)
    # Where a body of revolution spins or a bar slides along itself, its facets move, but the
    # surface that they approximate does not: nor does the membrane.
    across = np.concatenate([rows(face, touching.points, center) for face in touching.faces])
    found = directions(across.T @ across / max(len(across), 1), contact.radius_m)
    slides, seen = _SLIDING * found.deviation_m >= 1.0, np.eye(6)
    seen[:, 3:] -= spins(found.motions[:, slides])
    moving = seen @ (found.motions * ~slides) @ np.linalg.inv(found.motions)
    return Press(
        T_B_O=T_B_O,
        center=center,
        part=part,
        nodes=x,
        slopes=np.einsum("pq,pni->qni", moving, slopes[:6]),
        seen=seen,
        rounding=slopes[6],
        push_n=touching.push(n),
        on_face=np.logical_and.reduce(reached, axis=1),
        tangent=tangent,
        friction_n=friction_n,
        gas_pa=gas_pa,
    )
