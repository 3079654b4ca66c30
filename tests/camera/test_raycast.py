"""First triangle on each ray, against a test of every triangle."""

import tracemalloc

import numpy as np
import pytest

from bubbleviz.camera import RayCaster
from bubbleviz.membrane import mesh_cap, spherical_cap


def nearest(nodes, triangles, origin, rays):
    """Triangle that each ray meets first, −1 for none, and how far its edges are from the ray."""
    a, b, c = (nodes[triangles[:, k]] - origin for k in range(3))
    volumes = np.stack([rays @ np.cross(p, q).T for p, q in ((b, c), (c, a), (a, b))])
    total = volumes.sum(axis=0)
    inside = (volumes / total).min(axis=0)
    distance = np.einsum("mj,mj->m", a, np.cross(b, c)) / total
    distance[(inside < 0.0) | (distance < 0.0)] = np.inf
    first = distance.argmin(axis=1)
    met = np.isfinite(distance.min(axis=1))
    return np.where(met, first, -1), np.abs(inside).min(axis=1)


@pytest.mark.parametrize(
    "shape", ["dome", "dented", "folded", "cut", "notched", "around", "beside"]
)
def test_each_ray_finds_the_first_triangle_it_meets(shape):
    mesh = mesh_cap(spherical_cap(0.04, 0.03), 300)
    nodes, triangles, rng = mesh.nodes.copy(), mesh.triangles, np.random.default_rng(0)
    origin, width = np.array([0.002, 0.001, -0.09]), 0.04
    high = nodes[:, 2] / nodes[:, 2].max()
    if shape == "dented":
        nodes[:, 2] *= 1.0 - 0.5 * high**4
    elif shape == "folded":
        nodes[:, 0] += 0.035 * high**12
    elif shape == "cut":
        centre = nodes[triangles].mean(axis=1)
        triangles = triangles[np.hypot(centre[:, 0] - 0.04, centre[:, 1]) > 0.03]
    elif shape == "notched":  # few rays miss; turned, so that some would walk across the notch
        azimuth = np.arctan2(*nodes[triangles].mean(axis=1)[:, 1::-1].T)
        triangles, width = triangles[np.abs(azimuth) > 0.5], 0.015
        nodes[:, :2] = nodes[:, :2] @ [[0.7, 0.7], [-0.7, 0.7]]
    elif shape == "around":
        origin = np.array([0.0, 0.0, 0.01])
    elif shape == "beside":
        origin = np.array([0.09, 0.0, 0.0])
    rays = nodes.mean(axis=0) - origin + rng.normal(0.0, [width, width, 0.01], (1000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    expected, from_edge = nearest(nodes, triangles, origin, rays)
    clear = from_edge > 1e-4  # single precision may take either side of an edge
    assert clear.sum() > 800
    assert (expected[clear] >= 0).any() and (expected[clear] < 0).any()
    caster = RayCaster(origin, rays, triangles)
    for near in (None, caster.first(mesh.nodes)):  # anew, and from the triangles met at rest
        found = caster.first(nodes, near=near)
        np.testing.assert_array_equal(found[clear], expected[clear])


def test_casting_a_whole_image_takes_little_more_memory_than_its_hits():
    mesh, origin = mesh_cap(spherical_cap(0.04, 0.03), 300), np.array([0.0, 0.0, -0.09])
    side = np.linspace(-0.3, 0.3, 500)
    rays = np.stack(np.meshgrid(side, side, [1.0]), -1).reshape(-1, 3)
    caster = RayCaster(origin, rays / np.linalg.norm(rays, axis=1, keepdims=True), mesh.triangles)
    caster.cast(mesh.nodes)
    tracemalloc.start()
    try:
        hits = caster.cast(mesh.nodes)
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(hits.ray) > 100_000
    assert peak < 2.5 * kept
