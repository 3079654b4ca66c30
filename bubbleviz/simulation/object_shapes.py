"""The objects in `presets/objects`, made in code.

All are in metres and watertight with outward normals. The feature that presses points to −z and
touches the origin of O, so that the identity rotation presses it onto the dome from above.
`python -m bubbleviz.simulation.object_shapes presets/objects` writes the files.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bubbleviz.rigid_object import RigidObject


def frustum() -> RigidObject:
    """Pyramidal frustum of the paper's Fig. 7: 25 mm square tip, 59.5 mm base, 40 mm tall.

    The side faces lie as on the printed part (they would meet a 60 mm base); its base edge is
    rounded to 59.5 mm, here cut vertical.
    """
    tip, base, height, slope = 0.0125, 0.02974, 0.040, 0.0175 / 0.040
    edge = (base - tip) / slope
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)
    levels = [(tip, 0.0), (base, edge), (base, height)]
    return lathe("frustum", [(r * corners, z) for r, z in levels])


def cylinder() -> RigidObject:
    """Cylinder, flat end down: radius 12 mm, 40 mm tall."""
    circle = 0.012 * _circle(96)
    return lathe("cylinder", [(circle, 0.0), (circle, 0.040)])


def puck() -> RigidObject:
    """Puck, flat side down: radius 12 mm, its edge rounded by 4 mm, 20 mm tall; not shipped."""
    turn = np.linspace(0.0, 0.5 * np.pi, 12)
    profile = [(0.008 + 0.004 * np.sin(a), 0.004 * (1.0 - np.cos(a))) for a in turn]
    return lathe("puck", [(r * _circle(96), z) for r, z in [*profile, (0.012, 0.020)]])


def sphere() -> RigidObject:
    """Ball of radius 15 mm (vertices on the sphere, facets within 0.01 mm)."""
    vertices, triangles = _icosphere(4)
    return _outward("sphere", 0.015 * vertices + [0.0, 0.0, 0.015], triangles)


def two_spheres() -> RigidObject:
    """Two balls of radius 9 mm with centres 30 mm apart along x."""
    vertices, triangles = _icosphere(3)
    left = 0.009 * vertices + [-0.015, 0.0, 0.009]
    right = 0.009 * vertices + [0.015, 0.0, 0.009]
    both = np.concatenate([triangles, triangles + len(vertices)])
    return _outward("two_spheres", np.concatenate([left, right]), both)


def torus() -> RigidObject:
    """Ring lying flat: radius 18 mm to the middle of a 12 mm thick tube."""
    major, minor, around, across = 0.018, 0.006, 72, 36
    a, b = np.meshgrid(
        np.arange(around) * 2 * np.pi / around,
        np.arange(across) * 2 * np.pi / across,
        indexing="ij",
    )
    radius = major + minor * np.cos(b)
    z = minor + minor * np.sin(b)
    vertices = np.stack([radius * np.cos(a), radius * np.sin(a), z], axis=-1).reshape(-1, 3)
    vertices[:, 2] -= vertices[:, 2].min()
    return _outward("torus", vertices, _grid(around, across))


def two_legged_toy() -> RigidObject:
    """Body on two legs (paper's Fig. 2): feet 12 mm × 18 mm, 18 mm apart, legs 16 mm long."""
    outer = np.array([[-21, 0], [-21, 40], [21, 40], [21, 0]]) * 1e-3
    inner = np.array([[-9, 0], [-9, 16], [9, 16], [9, 0]]) * 1e-3
    return _prism("two_legged_toy", outer, inner, 0.018, closed=False, axis="y")


def bridge() -> RigidObject:
    """Arch on two abutments: span 24 mm, abutments 10 mm × 25 mm, 24 mm tall."""
    angle = np.linspace(np.pi, 0.0, 25)
    arch = 0.012 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # Outline of the block seen from the arch's middle, corner included.
    reach = np.minimum(
        0.022 / np.maximum(np.abs(np.cos(angle)), 1e-12), 0.024 / np.maximum(np.sin(angle), 1e-12)
    )
    outline = reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for sign in (-1.0, 1.0):
        corner = np.array([sign * 0.022, 0.024])
        outline[np.linalg.norm(outline - corner, axis=1).argmin()] = corner
    outline[[0, -1], 1], arch[[0, -1], 1] = 0.0, 0.0
    return _prism("bridge", outline, arch, 0.025, closed=False, axis="y")


def hex_nut() -> RigidObject:
    """Nut lying flat: 24 mm across flats, 14 mm hole, 10 mm thick."""
    side = 12
    corners = 0.024 / np.sqrt(3.0) * _circle(6)
    t = np.arange(side)[:, None] / side
    hexagon = np.concatenate([corners[k] * (1.0 - t) + corners[(k + 1) % 6] * t for k in range(6)])
    hole = 0.007 * hexagon / np.linalg.norm(hexagon, axis=1, keepdims=True)
    return _prism("hex_nut", hexagon, hole, 0.010, closed=True, axis="z")


def cross() -> RigidObject:
    """Cross of two bars 40 mm × 10 mm, 20 mm tall, flat end down; not shipped, held out."""
    outline = _cross_outline(0.020, 0.005)
    rings = [np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, 0.020)]
    return _stacked("cross", rings)


def bar() -> RigidObject:
    """Bar lying flat: 40 mm × 10 mm, 12 mm thick; not shipped, held out."""
    corners = np.array([[-0.02, -0.005], [0.02, -0.005], [0.02, 0.005], [-0.02, 0.005]])
    return lathe("bar", [(corners, 0.0), (corners, 0.012)])


def ring() -> RigidObject:
    """Tube on its end: radii 9 and 16 mm, edge rounded by 2 mm, 30 mm tall; not shipped."""
    return _rounded("ring", 0.016 * _circle(72), 0.002, hole=0.009 * _circle(72))


def small_nut() -> RigidObject:
    """Nut 18 mm across flats with an 8 mm hole, edge rounded by 1.5 mm; not shipped."""
    hexagon = _filleted(0.018 / np.sqrt(3.0) * _circle(6), 0.003)
    hole = 0.004 * hexagon / np.linalg.norm(hexagon, axis=1, keepdims=True)
    return _rounded("small_nut", hexagon, 0.0015, hole=hole)


def thin_bar() -> RigidObject:
    """Bar of 36 mm × 8 mm, edge rounded by 2 mm, 30 mm tall; not shipped."""
    half = np.array([0.018, 0.004])
    return _rounded(
        "thin_bar", _filleted(half * [[-1, -1], [1, -1], [1, 1], [-1, 1]], 0.003), 0.002
    )


def ell() -> RigidObject:
    """L of two arms 26 mm × 12 mm, edge rounded by 2 mm, 30 mm tall; not shipped."""
    outline = np.array([[-6, -6], [20, -6], [20, 6], [6, 6], [6, 20], [-6, 20]])
    return _rounded("ell", _filleted(1e-3 * outline, 0.005), 0.002)


def rounded_cross() -> RigidObject:
    """Cross of two bars 40 mm × 12 mm, edge rounded by 2 mm, 30 mm tall; not shipped."""
    return _rounded("rounded_cross", _filleted(_cross_outline(0.020, 0.006), 0.003), 0.002)


def unequal_balls() -> RigidObject:
    """Balls of radius 7 and 11 mm whose lowest points are 24 mm apart; not shipped."""
    vertices, triangles = _icosphere(4)
    small = 0.007 * vertices + [-0.011, 0.0, 0.007]
    large = 0.011 * vertices + [0.013, 0.0, 0.011]
    both = np.concatenate([triangles, triangles + len(vertices)])
    return _outward("unequal_balls", np.concatenate([small, large]), both)


GENERATORS: tuple[Callable[[], RigidObject], ...] = (
    frustum, two_legged_toy, bridge, sphere, torus, two_spheres, cylinder, hex_nut,
)  # fmt: skip


def ply_bytes(obj: RigidObject) -> bytes:
    """Binary PLY file of an object: float32 vertices, int32 triangles."""
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment {obj.name}, metres, presses to -z\n"
        f"element vertex {len(obj.vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(obj.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(obj.triangles), dtype=[("n", "u1"), ("i", "<i4", 3)])
    faces["n"], faces["i"] = 3, obj.triangles
    return header.encode() + obj.vertices.astype("<f4").tobytes() + faces.tobytes()


def _outward(name: str, vertices: np.ndarray, triangles: np.ndarray) -> RigidObject:
    """Object with its triangles turned outward, vertices as the file has them (float32)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    if np.einsum("ij,ij->", np.cross(b - a, c - a), a) < 0.0:
        triangles = triangles[:, [0, 2, 1]]
    return RigidObject(name, vertices.astype(np.float32).astype(np.float64), triangles)


def lathe(name: str, sections: list[tuple[np.ndarray, float]]) -> RigidObject:
    """Convex sections (k, 2) stacked along z, joined and closed at both ends."""
    k = len(sections[0][0])
    rings = [np.column_stack([xy, np.full(k, z)]) for xy, z in sections]
    sides = [
        triangle
        for level in range(len(sections) - 1)
        for triangle in _ring_of_quads(level * k, (level + 1) * k, k, closed=True)
    ]
    bottom = [[0, i + 1, i] for i in range(1, k - 1)]
    last = (len(sections) - 1) * k
    top = [[last, last + i, last + i + 1] for i in range(1, k - 1)]
    return _outward(name, np.concatenate(rings), np.array(sides + bottom + top))


def _cross_outline(arm: float, half: float) -> np.ndarray:
    quarter = np.array([[arm, -half], [arm, half], [half, half]])
    turns = [np.array([[c, -s], [s, c]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    return np.concatenate([quarter @ turn.T for turn in turns])


def _rounded(
    name: str, outline: np.ndarray, radius: float, hole: np.ndarray | None = None
) -> RigidObject:
    """Outline (k, 2), anticlockwise, extruded by 30 mm, its lower edge rounded.

    It sees its whole self from the origin. A hole has as many points, and goes through.
    """
    turn = np.linspace(0.0, 0.5 * np.pi, 6)
    profile = [(radius * (1.0 - np.sin(a)), radius * (1.0 - np.cos(a))) for a in turn]
    profile.append((0.0, 0.030))

    def ring(edge: np.ndarray, inwards: float, z: float) -> np.ndarray:
        return np.column_stack([_inset(edge, inwards), np.full(len(edge), z)])

    outside = [ring(outline, by, z) for by, z in profile]
    if hole is None:
        return _stacked(name, outside)
    rings = outside + [ring(hole, -by, z) for by, z in reversed(profile)]
    k, levels = len(outline), len(rings)
    triangles = [
        each
        for level in range(levels)
        for each in _ring_of_quads(level * k, (level + 1) % levels * k, k, closed=True)
    ]
    return _outward(name, np.concatenate(rings), np.array(triangles))


def _filleted(outline: np.ndarray, radius: float) -> np.ndarray:
    """Anticlockwise outline (k, 2) whose corners are arcs."""
    ahead = np.roll(outline, -1, axis=0) - outline
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    arcs = []
    for p, a, b in zip(outline, ahead, -np.roll(ahead, 1, axis=0), strict=True):
        turn = np.pi - np.arccos(a @ b)
        half, share = 0.5 * turn, np.linspace(0.0, 1.0, 7)[:, None]
        center = p + radius / np.cos(half) * (a + b) / np.linalg.norm(a + b)
        begin, end = (p + radius * np.tan(half) * side - center for side in (b, a))
        spread = np.sin((1.0 - share) * turn) * begin + np.sin(share * turn) * end
        arcs.append(center + spread / np.sin(turn))
    return np.concatenate(arcs)


def _inset(outline: np.ndarray, by: float) -> np.ndarray:
    """Anticlockwise outline (k, 2) with every side moved inwards."""
    side = np.roll(outline, -1, axis=0) - outline
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    after = np.stack([-side[:, 1], side[:, 0]], axis=1)
    before = np.roll(after, 1, axis=0)
    corner = 1.0 + np.einsum("ij,ij->i", before, after)
    return outline + by * (before + after) / corner[:, None]


def _stacked(name: str, rings: list[np.ndarray]) -> RigidObject:
    """Outlines (k, 3) that see their whole selves from the axis, joined and closed at both ends."""
    k, levels = len(rings[0]), len(rings)
    centres = np.array([[0.0, 0.0, rings[0][0, 2]], [0.0, 0.0, rings[-1][0, 2]]])
    triangles = [
        each
        for level in range(levels - 1)
        for each in _ring_of_quads(level * k, (level + 1) * k, k, closed=True)
    ]
    bottom, top, last = levels * k, levels * k + 1, (levels - 1) * k
    for i in range(k):
        j = (i + 1) % k
        triangles += [[bottom, j, i], [top, last + i, last + j]]
    return _outward(name, np.concatenate([*rings, centres]), np.array(triangles))


def _prism(
    name: str, outer: np.ndarray, inner: np.ndarray, depth: float, *, closed: bool, axis: str
) -> RigidObject:
    """Band between two outlines (k, 2) with matching points, extruded along y or z.

    A closed band is a ring; an open one has its two ends closed.
    """
    k = len(outer)
    low, high = (-0.5 * depth, 0.5 * depth) if axis == "y" else (0.0, depth)
    flat = np.concatenate([outer, inner, outer, inner])
    along = np.repeat([low, high], 2 * k)
    x, second = flat.T
    columns = [x, along, second] if axis == "y" else [x, second, along]
    o, i, O, I = 0, k, 2 * k, 3 * k  # noqa: E741  outlines at the low and the high end
    triangles: list[list[int]] = []
    for first, following in ((o, i), (i, I), (I, O), (O, o)):
        triangles += _ring_of_quads(first, following, k, closed=closed)
    if not closed:
        for e, turn in ((0, 1), (k - 1, -1)):
            triangles += [[o + e, i + e, I + e][::turn], [o + e, I + e, O + e][::turn]]
    return _outward(name, np.stack(columns, axis=1), np.array(triangles))


def _ring_of_quads(first: int, second: int, k: int, *, closed: bool) -> list[list[int]]:
    """Quads, cut in two, between two rows of k vertices that start at the given indices."""
    triangles = []
    for a in range(k if closed else k - 1):
        b = (a + 1) % k
        triangles += [[first + a, first + b, second + b], [first + a, second + b, second + a]]
    return triangles


def _grid(rows: int, columns: int) -> np.ndarray:
    """Triangles of a grid of vertices that closes in both directions."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = (i * columns + j).ravel()
    b = ((i + 1) % rows * columns + j).ravel()
    c = ((i + 1) % rows * columns + (j + 1) % columns).ravel()
    d = (i * columns + (j + 1) % columns).ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _circle(count: int) -> np.ndarray:
    angle = np.arange(count) * 2.0 * np.pi / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _icosphere(levels: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit sphere: an icosahedron with a vertex at each pole, cut in four `levels` times."""
    ring = _circle(5) * 2.0 / np.sqrt(5.0)
    turned = _circle(10)[1::2] * 2.0 / np.sqrt(5.0)
    up = 1.0 / np.sqrt(5.0)
    vertices = np.concatenate(
        [
            [[0.0, 0.0, 1.0]],
            np.column_stack([ring, np.full(5, up)]),
            np.column_stack([turned, np.full(5, -up)]),
            [[0.0, 0.0, -1.0]],
        ]
    )
    triangles = np.array(
        [[0, 1 + k, 1 + (k + 1) % 5] for k in range(5)]
        + [[1 + k, 6 + k, 1 + (k + 1) % 5] for k in range(5)]
        + [[6 + k, 6 + (k + 1) % 5, 1 + (k + 1) % 5] for k in range(5)]
        + [[11, 6 + (k + 1) % 5, 6 + k] for k in range(5)]
    )
    for _ in range(levels):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        middle = vertices[unique].sum(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        m = which.reshape(-1, 3) + len(vertices)
        a, b, c = triangles.T
        triangles = np.concatenate(
            [
                np.stack([a, m[:, 0], m[:, 2]], axis=1),
                np.stack([b, m[:, 1], m[:, 0]], axis=1),
                np.stack([c, m[:, 2], m[:, 1]], axis=1),
                m,
            ]
        )
        vertices = np.concatenate([vertices, middle])
    return vertices, triangles


if __name__ == "__main__":
    for generator in GENERATORS:
        made = generator()
        (Path(sys.argv[1]) / f"{made.name}.ply").write_bytes(ply_bytes(made))
