"""Depth image and exact optical flow of a known membrane."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bubbleviz.camera import BLOCK_PX, DepthCamera, FlowField, MembraneView
from bubbleviz.simulation import DepthNoise
from tests.oracles.stuck_press import ShearTruth

_HIDDEN_M = 1e-3  # a point is hidden if it is further than this behind the surface in its pixel


class FlowSighting(NamedTuple):
    """A frame; depth and colour camera are identical."""

    depth_m: np.ndarray  # (H, W) float32
    flow: FlowField


def sighting(
    camera: DepthCamera, truth: ShearTruth, depth_noise: DepthNoise, flow_sigma_px: float, seed: int
) -> FlowSighting:
    """Depth with noise, and the flow at the centre of every block with white noise."""
    view, intrinsics = MembraneView(camera, truth.mesh), camera.intrinsics
    range_m = view.range_image(truth.displacement_m)
    row, column = np.divmod(np.arange(range_m.size), intrinsics.width)
    middle = BLOCK_PX // 2
    chosen = (row % BLOCK_PX == middle) & (column % BLOCK_PX == middle)
    hits = view.hits(np.zeros_like(truth.displacement_m), np.flatnonzero(chosen))
    now = truth.mesh.nodes + truth.displacement_m
    corners = now[truth.mesh.triangles[hits.triangle]]
    away = np.einsum("ij,ijk->ik", hits.barycentric, corners) - camera.center
    places = intrinsics.project(away @ camera.T_B_C[:3, :3])
    nearest = np.rint(places).astype(int)
    inside = np.all((nearest >= 0) & (nearest < [intrinsics.width, intrinsics.height]), axis=1)
    surface = np.full(len(nearest), np.nan)
    surface[inside] = range_m[nearest[inside, 1], nearest[inside, 0]]
    seen = np.linalg.norm(away, axis=1) < surface + _HIDDEN_M
    moved = places - np.stack([column[hits.ray], row[hits.ray]], axis=1)
    moved += flow_sigma_px * np.random.default_rng([seed, 5]).standard_normal(moved.shape)
    sigma = np.full(int(np.count_nonzero(seen)), flow_sigma_px)
    depth = depth_noise.depth_image(camera, range_m, seed, 0)
    return FlowSighting(depth, FlowField(hits.ray[seen], moved[seen], sigma, depth.shape))
