"""Rotational symmetries of objects."""

import numpy as np
import pytest

from bubbleviz.membrane import ObjectSurface
from bubbleviz.rigid_object import RigidObject
from bubbleviz.simulation import study_object
from bubbleviz.study.symmetries import symmetries

GROUPS = {
    "frustum": 4, "two_legged_toy": 2, "cross": 8, "hex_nut": 12, "sphere": 1, "cylinder": 720,
}  # fmt: skip


@pytest.mark.parametrize(("name", "count"), GROUPS.items())
def test_symmetries(name, count):
    model = ObjectSurface(study_object(name))
    found = symmetries(model)
    assert len(found) == count
    assert np.allclose(found[0], np.eye(4))
    for T in found[:: max(1, len(found) // 9)]:
        turned = model.obj.vertices @ T[:3, :3].T + T[:3, 3]
        way = np.linalg.norm(turned - model.closest(turned).place, axis=1)
        assert way.max() < 5e-3 * model.size_m


def prism(sides):
    """A straight prism over a regular polygon of 10 mm radius, 25 mm high."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = 0.01 * np.column_stack([np.cos(angle), np.sin(angle)])
    vertices = np.vstack([np.c_[ring, np.zeros(sides)], np.c_[ring, np.full(sides, 0.025)]])
    k = np.arange(sides)
    j = (k + 1) % sides
    faces = [np.c_[k, j, j + sides], np.c_[k, j + sides, k + sides]]
    fan = np.c_[np.zeros(sides - 2, int), k[1:-1], k[2:]]
    return RigidObject(f"prism {sides}", vertices, np.vstack([*faces, fan[:, ::-1], fan + sides]))


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 8])
def test_prism_has_rotations_and_flips_of_its_polygon(sides):
    assert len(symmetries(ObjectSurface(prism(sides)))) == 2 * sides


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 8])
def test_pyramid_has_only_rotations_of_its_polygon(sides):
    whole = prism(sides)
    base = whole.triangles[2 * sides : 3 * sides - 2]
    k = np.arange(sides)
    faces = np.c_[k, (k + 1) % sides, np.full(sides, sides)]
    vertices = np.vstack([whole.vertices[:sides], [0.0, 0.0, 0.025]])
    pyramid = RigidObject(f"pyramid {sides}", vertices, np.vstack([faces, base]))
    assert len(symmetries(ObjectSurface(pyramid))) == sides
