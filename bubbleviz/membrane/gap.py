"""How far each node may move outward before it meets a rigid object (Eqs. 10 to 12)."""

from __future__ import annotations

import numpy as np

from bubbleviz.camera.triangle_scene import TriangleScene
from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh, area_vectors
from bubbleviz.rigid_object import RigidObject


class GapFinder:
    """Casts the normal lines of a membrane at rigid objects.

    The object presses from outside, so the membrane stays on the inner side of it: along its
    normal line node k may go up to the lowest place where the line enters the object, whether
    that is above the node (a gap) or below (a penetration, which Eq. 16 undoes). A place beyond
    half way to the opposite side of the dome, or of the rim's cylinder below it, belongs to the
    membrane over there; one deeper than a rim radius behind the rim to nobody. Both are left out,
    unless the node itself is in the same stretch of the object. Where an object is not watertight
    nothing tells in from out and every hit counts as an entry.

    Parameters
    ----------
    mesh : MembraneMesh
    """

    def __init__(self, mesh: MembraneMesh) -> None:
        self.mesh = mesh
        self._reach: np.ndarray | None = None
        self._object: RigidObject | None = None
        self._scene: TriangleScene | None = None
        self._solid = False

    def gaps(self, obj: RigidObject, T_B_O: np.ndarray) -> np.ndarray:
        """Upper bound g of the displacement, shape (n,), m; inf where the object is not met."""
        pose = checked_pose(T_B_O)
        if obj is not self._object:
            self._load(obj)
        nodes = (self.mesh.nodes - pose[:3, 3]) @ pose[:3, :3]
        normals = self.mesh.normals @ pose[:3, :3]
        ray, where, entering = self._hits(nodes, normals)
        return self._lowest_entry(ray, where, entering)

    def _load(self, obj: RigidObject) -> None:
        scene = TriangleScene(obj.vertices, obj.triangles)
        a, vectors = obj.vertices[obj.triangles[:, 0]], area_vectors(obj.vertices, obj.triangles)
        self._solid = is_watertight(obj.triangles)
        if self._solid and np.einsum("ij,ij->", vectors, a) < 0.0:
            vectors = -vectors  # inward normals: the signed volume is negative
        self._object, self._scene = obj, scene
        self._corner, self._vectors = a, vectors
        self._centre = 0.5 * (obj.vertices.min(axis=0) + obj.vertices.max(axis=0))
        self._radius = float(np.linalg.norm(obj.vertices - self._centre, axis=1).max())

    def _hits(
        self, nodes: np.ndarray, normals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All crossings of the node's lines: node, place along n̂ in m, entering or leaving."""
        # Start each ray just before the object's bounding sphere, where single precision is best.
        middle = np.einsum("ij,ij->i", self._centre - nodes, normals)
        miss = np.linalg.norm(nodes + middle[:, None] * normals - self._centre, axis=1)
        near = np.flatnonzero(miss <= self._radius)
        if not len(near):  # Open3D crashes on no rays
            return near, np.zeros(0), np.zeros(0, dtype=bool)
        start = middle[near] - 1.01 * self._radius
        origins = nodes[near] + start[:, None] * normals[near]
        assert self._scene is not None
        hit, facet = self._scene.crossings(np.hstack([origins, normals[near]]))
        ray = near[hit]
        # The place again in double precision, from the plane of the facet that was hit.
        vectors = self._vectors[facet]
        slope = np.einsum("ij,ij->i", vectors, normals[ray])
        distance = np.einsum("ij,ij->i", vectors, self._corner[facet] - nodes[ray])
        kept = np.abs(slope) > 1e-7 * np.linalg.norm(vectors, axis=1)  # not along the facet
        return ray[kept], distance[kept] / slope[kept], slope[kept] < 0.0

    def _lowest_entry(self, ray: np.ndarray, where: np.ndarray, entering: np.ndarray) -> np.ndarray:
        n = len(self.mesh.nodes)
        lowest = np.full(n, np.inf)
        counts = entering if self._solid else np.ones_like(entering)
        # The stretch the node is in: its highest crossing below the node is an entry.
        below = counts & (where <= 0.0)
        last = np.full(n, -np.inf)
        np.maximum.at(last, ray[where <= 0.0], where[where <= 0.0])
        own = below & (where == last[ray])
        valid = counts & ((where >= -self.reach[ray]) | own)
        np.minimum.at(lowest, ray[valid], where[valid])
        return lowest

    @property
    def reach(self) -> np.ndarray:
        """Distance inward along each normal that belongs to the node's own line, (n,), m."""
        if self._reach is None:
            mesh = self.mesh
            step = 1e-3 * np.sqrt(mesh.facet_areas.sum())  # clear of the node's own triangles
            rays = np.hstack([mesh.nodes - step * mesh.normals, -mesh.normals])
            across = 0.5 * (TriangleScene(mesh.nodes, mesh.triangles).cast(rays).distance + step)
            self._reach = np.minimum(across, _way_through_chamber(mesh))
        return self._reach


def _way_through_chamber(mesh: MembraneMesh) -> np.ndarray:
    """Way inward to half through the rim's cylinder, or to one rim radius behind the rim."""
    radius = float(np.hypot(*mesh.nodes[mesh.rim, :2].T).max())
    x, n = mesh.nodes[:, :2], mesh.normals[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        down = (mesh.nodes[:, 2] + radius) / mesh.normals[:, 2]
        a, b = np.einsum("ij,ij->i", n, n), np.einsum("ij,ij->i", x, n)
        root = np.sqrt(b**2 - a * (np.einsum("ij,ij->i", x, x) - radius**2))
        side = 0.5 * (b + root) / a  # NaN where the line never enters the cylinder
    down[~(down > 0.0)] = np.inf
    return np.fmin(down, np.where(side > 0.0, side, np.inf))


def checked_pose(T_B_O: np.ndarray) -> np.ndarray:
    """Pose as a 4×4 float array; InputError where it is no rigid transform."""
    pose = np.asarray(T_B_O, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise InputError("pose T_B_O: not a finite 4×4 matrix; give a rigid transform")
    if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-6 or (
        np.linalg.det(pose[:3, :3]) < 0.0
    ):
        raise InputError("pose T_B_O: its 3×3 part is no rotation; give a rigid transform")
    if np.abs(pose[:3, 3]).max() > 10.0:
        raise InputError(
            f"pose T_B_O: {np.abs(pose[:3, 3]).max():.4g} m away; is it in millimetres? use metres"
        )
    return pose


def is_watertight(triangles: np.ndarray) -> bool:
    """Whether every edge has two triangles that run along it in opposite directions."""
    n = int(triangles.max()) + 1
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    forward, backward = np.sort(start * n + end), np.sort(end * n + start)
    once = bool((np.diff(forward) > 0).all())
    return once and bool((forward == backward).all())
