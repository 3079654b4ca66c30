"""Rotations that map an object onto itself, found near others."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bubbleviz.membrane import ObjectSurface
from bubbleviz.rigid_object import RigidObject
from bubbleviz.simulation import study_object

OFF = Rotation.from_rotvec(np.radians([2.0, -1.5, 2.5]))


def turns(sides):
    """Rotations of a regular polygon in the plane z = 0."""
    return Rotation.from_rotvec(2.0 * np.pi / sides * np.outer(np.arange(sides), [0.0, 0.0, 1.0]))


FLIP = Rotation.from_euler("x", 180.0, degrees=True)


def prism(sides, apex=False):
    """A straight prism over a regular polygon of 10 mm radius, 25 mm high; or a pyramid."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = 0.01 * np.column_stack([np.cos(angle), np.sin(angle)])
    top = np.zeros_like(ring) if apex else ring
    vertices = np.vstack([np.c_[ring, np.zeros(sides)], np.c_[top, np.full(sides, 0.025)]])
    k = np.arange(sides)
    j = (k + 1) % sides
    faces = [np.c_[k, j, j + sides], np.c_[k, j + sides, k + sides]]
    fan = np.c_[np.zeros(sides - 2, int), k[1:-1], k[2:]]
    return RigidObject(f"prism {sides}", vertices, np.vstack([*faces, fan[:, ::-1], fan + sides]))


def same(found, turn):
    return (Rotation.from_matrix(found[:3, :3]) * turn.inv()).magnitude() < 1e-5


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 8])
def test_prism_has_rotations_and_flips_of_its_polygon(sides):
    obj = prism(sides)
    model = ObjectSurface(obj)
    for symmetry in (*turns(sides), *(FLIP * each for each in turns(sides))):
        found = model.nearest_symmetry((OFF * symmetry).as_matrix())
        assert same(found, symmetry)
        turned = obj.vertices @ found[:3, :3].T + found[:3, 3]
        apart = np.linalg.norm(turned[:, None] - obj.vertices, axis=2)
        assert apart.min(axis=1).max() < 1e-7


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 8])
def test_pyramid_has_only_rotations_of_its_polygon(sides):
    model = ObjectSurface(prism(sides, apex=True))
    for symmetry in turns(sides):
        assert same(model.nearest_symmetry((OFF * symmetry).as_matrix()), symmetry)
        assert model.nearest_symmetry((OFF * FLIP * symmetry).as_matrix()) is None


def test_spin_of_a_round_object_stays_and_its_tilt_does_not():
    model = ObjectSurface(study_object("cylinder"))
    spin = Rotation.from_euler("z", 0.7)
    found = Rotation.from_matrix(
        model.nearest_symmetry((Rotation.from_euler("x", 0.05) * spin).as_matrix())[:3, :3]
    )
    assert np.abs((found * spin.inv()).as_rotvec()).max() < 2e-3


@pytest.mark.parametrize("name", ["two_legged_toy", "frustum", "bridge"])
def test_an_object_turned_otherwise_looks_different(name):
    model = ObjectSurface(study_object(name))
    assert model.nearest_symmetry(Rotation.from_euler("x", 1.5).as_matrix()) is None


def test_a_symmetry_is_found_within_an_angle():
    model = ObjectSurface(prism(5))
    for symmetry in (*turns(5), *(FLIP * each for each in turns(5))):
        turn = (OFF * symmetry).as_matrix()
        assert same(model.nearest_symmetry(turn, within_rad=1.01 * OFF.magnitude()), symmetry)
        assert model.nearest_symmetry(turn, within_rad=0.99 * OFF.magnitude()) is None
