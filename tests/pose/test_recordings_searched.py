"""Poses of simulated recordings without a first pose, against the true ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bubbleviz as bv
from bubbleviz.membrane import build_mesh
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import DepthNoise, SyntheticSource, study_object, touching_height
from tests.small_press import changed, coarser

TOY = study_object("two_legged_toy")


@pytest.fixture(scope="module")
def sensor():
    return changed(load_sensor("pico_flexx_75mm"), membrane={"nodes": 400})


def pressed(sensor, turns, depths_m, times_s):
    """Frames and true poses of a toy turned about z, then x, in degrees."""
    path = np.tile(np.eye(4), (len(turns), 1, 1))
    path[:, :3, :3] = Rotation.from_euler("ZX", turns, degrees=True).as_matrix()
    path[:, :2, 3] = -7e-3, 8.6e-3
    mesh = build_mesh(sensor)
    path[:, 2, 3] = [touching_height(TOY, T, mesh) for T in path] - np.array(depths_m)
    source = SyntheticSource(sensor, TOY, path, DepthNoise(absolute_m=1.5e-4), nodes=2_000)
    return [replace(source[k], time_s=time_s) for k, time_s in enumerate(times_s)], path


def off_deg(run, truth):
    """Angles between the poses of a run and the true ones, or those after half a turn of the toy.

    After that it looks the same.
    """
    assert {row["status"] for row in run.poses} == {"ok"}
    turns = np.swapaxes(run.T_B_O[:, :3, :3], 1, 2) @ truth[:, :3, :3]
    half = np.diag([-1.0, -1.0, 1.0])
    angles = [Rotation.from_matrix(each).magnitude() for each in (turns, turns @ half)]
    return np.degrees(np.min(angles, axis=0))


def test_a_second_press_is_searched_at_its_own_largest_patch(sensor):
    """The first is deeper, on another side; the second begins with a touch that fits many poses."""
    turns, depths_m = [(10.0, 86.0), (10.0, -4.0), (10.0, -4.0)], [10e-3, 1e-3, 9.5e-3]
    frames, truth = pressed(sensor, turns, depths_m, [0.0, 1.5, 1.6])
    assert off_deg(bv.track(frames, TOY, sensor), truth).max() < 15.0


def test_a_turning_object_is_followed_back_from_its_largest_patch(sensor):
    turns, depths_m = [(8.0 * k, -4.0) for k in range(4)], np.linspace(6e-3, 9.5e-3, 4)
    small = changed(sensor, camera=coarser(sensor, 2))
    frames, truth = pressed(small, turns, depths_m, np.arange(4) / 15.0)
    assert off_deg(bv.track(frames, TOY, small), truth).max() < 5.0
