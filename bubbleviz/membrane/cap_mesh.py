"""Analytic reference surfaces and the triangle meshes made on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay

from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.smoothing import lawson_flips, smooth


@dataclass(frozen=True)
class EllipsoidalCap:
    """Cap of an ellipsoid above the plane z = 0, centred on the z axis, apex at +z."""

    rim_semi_axes_m: tuple[float, float]  # (ax, ay), semi-axes of the rim ellipse along x and y, m
    height_m: float  # apex above the rim plane, m
    # vertical semi-axis c of the whole ellipsoid, m; more than half the height. The cap is less
    # than half of the ellipsoid where c > height and more where c < height.
    vertical_semi_axis_m: float

    @classmethod
    def of(
        cls, rim_semi_axes_m: tuple[float, float], height_m: float, c_m: float | None = None
    ) -> EllipsoidalCap:
        """Cap over a rim of given height; c from the rim and height where it is not given.

        Rim and height leave c open. An inflated membrane of uniform tension has the same mean
        curvature everywhere, so c is taken from the spherical cap of that height whose rim
        radius a has 2/a² = 1/ax² + 1/ay²: the apex then has that sphere's mean curvature 1/c,
        and equal semi-axes give the spherical cap itself, c = (a² + h²)/(2h). Within 2 % of
        the c that balances the pressure on the whole cap against the pull at its rim.
        """
        ax, ay = rim_semi_axes_m
        if c_m is None:
            a2 = 2.0 / (ax**-2 + ay**-2)
            c_m = (a2 + height_m**2) / (2.0 * height_m)
        if not c_m > 0.5 * height_m:
            raise InputError(
                f"vertical semi-axis {c_m} m: at most half the height {height_m} m;"
                " give a larger one"
            )
        return cls((ax, ay), height_m, c_m)

    @property
    def semi_axes(self) -> np.ndarray:
        """Semi-axes of the whole ellipsoid, shape (3,), m."""
        c, h = self.vertical_semi_axis_m, self.height_m
        rim = np.sqrt(2.0 * h / c - (h / c) ** 2)  # radius of the rim on the unit sphere
        return np.array([self.rim_semi_axes_m[0] / rim, self.rim_semi_axes_m[1] / rim, c])

    @property
    def centre(self) -> np.ndarray:
        """Centre of the ellipsoid in B, shape (3,), m."""
        return np.array([0.0, 0.0, self.height_m - self.vertical_semi_axis_m])

    @property
    def rim_polar_angle(self) -> float:
        """Polar angle of the rim on the unit sphere that the ellipsoid is scaled from, rad."""
        return float(np.arccos(np.clip(1.0 - self.height_m / self.vertical_semi_axis_m, -1, 1)))

    def point(self, polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
        """Points at polar angle (0 at the apex) and azimuth on the unit sphere; (…, 3), m."""
        sine = np.sin(polar)
        unit = np.stack(
            [sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar) + 0.0 * azimuth], axis=-1
        )
        return self.centre + unit * self.semi_axes

    def project(self, points: np.ndarray) -> np.ndarray:
        """Points moved onto the ellipsoid along the line to its centre, shape (k, 3), m."""
        unit = (points - self.centre) / self.semi_axes
        return self.centre + unit / np.linalg.norm(unit, axis=1, keepdims=True) * self.semi_axes


def spherical_cap(rim_radius_m: float, height_m: float) -> EllipsoidalCap:
    """Cap of a sphere: rim radius a and height h, h > a being more than a hemisphere."""
    return EllipsoidalCap.of((rim_radius_m, rim_radius_m), height_m)


def mesh_cap(cap: EllipsoidalCap, nodes: int) -> MembraneMesh:
    """Near-uniform triangle mesh of a cap, with about `nodes` nodes, the same every time.

    Rings of equal spacing along every meridian, each with as many nodes as its share of the
    surface, are triangulated (Delaunay) and smoothed on the surface. Nodes lie on the surface,
    those of the rim on the rim; no direction is preferred.
    """
    rings = _rings(cap, nodes)
    polar, azimuth = np.concatenate(rings, axis=0).T
    # The stereographic map is conformal: Delaunay in this plane is Delaunay on the sphere.
    radius = np.tan(0.5 * polar)
    plane = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth)], axis=1)
    triangles = _counter_clockwise(plane, Delaunay(plane).simplices.astype(np.int64))
    points = cap.point(polar, azimuth)
    rim = np.zeros(len(points), dtype=bool)
    rim[-len(rings[-1]) :] = True
    points[rim, 2] = 0.0
    triangles = lawson_flips(points, triangles)
    held = rim.copy()
    held[0] = True  # a node at the apex, so that the mesh is as high as the cap
    points, triangles = smooth(points, triangles, held, cap.project)
    return MembraneMesh(nodes=points, triangles=triangles, rim=rim)


def _rings(cap: EllipsoidalCap, nodes: int) -> list[np.ndarray]:
    """Polar angle and azimuth of the nodes, ring by ring from the apex to the rim."""
    azimuth = np.linspace(0.0, 2.0 * np.pi, 721)
    polar = np.linspace(0.0, cap.rim_polar_angle, 257)
    meridians, area, rim_length = _measure(cap, polar, azimuth)
    edge = _edge_length(area, rim_length, nodes)
    count = max(2, round(float(meridians[-1].mean()) / (0.5 * np.sqrt(3.0) * edge)))
    fractions = np.arange(1, count + 1) / count  # of every meridian's length
    levels = np.stack([np.interp(fractions * m[-1], m, polar) for m in meridians.T], axis=1)
    levels[-1] = cap.rim_polar_angle
    steps = np.linalg.norm(np.diff(cap.point(levels, azimuth[None, :]), axis=1), axis=2)
    # The same area for every node: closer together where the rings are far apart.
    weights = steps * (meridians[-1, 1:] + meridians[-1, :-1])
    weights[-1] = steps[-1]
    sizes = _ring_sizes(steps.sum(axis=1), nodes)
    golden = 0.6180339887498949 * np.arange(count) % 1.0  # no seam where every ring starts
    golden[-1] = 0.0
    rings = [np.zeros((1, 2))]
    for size, offset, level, weight in zip(sizes, golden, levels, weights, strict=True):
        share = np.concatenate([[0.0], weight.cumsum() / weight.sum()])
        at = np.interp((np.arange(size) + offset) / size, share, azimuth)
        rings.append(np.stack([np.interp(at, azimuth, level), at], axis=1))
    return rings


def _measure(
    cap: EllipsoidalCap, polar: np.ndarray, azimuth: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Length along every meridian (polar × azimuth), area of the cap and length of its rim."""
    points = cap.point(polar[:, None], azimuth[None, :])
    along = np.linalg.norm(np.diff(points, axis=0), axis=2)
    around = np.linalg.norm(np.diff(points, axis=1), axis=2)
    cells = 0.25 * (along[:, 1:] + along[:, :-1]) * (around[1:] + around[:-1])
    meridians = np.concatenate([np.zeros((1, len(azimuth))), along.cumsum(axis=0)])
    return meridians, float(cells.sum()), float(around[-1].sum())


def _edge_length(area: float, rim_length: float, nodes: int) -> float:
    """Edge length at which equilateral triangles over `area` have about `nodes` nodes."""
    # nodes = area / (√3/2 d²) + rim/(2 d): a rim node owns half a cell
    linear, constant = 0.5 * rim_length, area / (0.5 * np.sqrt(3.0))
    return float((linear + np.sqrt(linear**2 + 4.0 * nodes * constant)) / (2.0 * nodes))


def _ring_sizes(lengths: np.ndarray, nodes: int) -> np.ndarray:
    """Nodes on each ring, in proportion to its length, adding up to nearly `nodes` − 1."""
    density = (nodes - 1) / lengths.sum()
    return np.maximum(np.rint(lengths * density).astype(int), 3)


def _counter_clockwise(plane: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Triangles of a plane triangulation turned counter-clockwise, slivers of no area left out."""
    a, b, c = (plane[triangles[:, k]] for k in range(3))
    e, f = b - a, c - a
    area = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    triangles = np.where(area[:, None] < 0.0, triangles[:, [0, 2, 1]], triangles)
    return triangles[np.abs(area) > 1e-12 * np.abs(area).max()]
