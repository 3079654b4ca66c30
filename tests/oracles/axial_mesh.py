"""Triangle mesh on the surface of revolution of a meridian."""

from __future__ import annotations

import numpy as np

from bubbleviz.membrane import MembraneMesh, mesh_cap, spherical_cap
from tests.oracles.rubber_oracle import Meridian


def swept_mesh(meridian: Meridian, nodes: int) -> MembraneMesh:
    """Mesh of about `nodes` nodes at material points, so that meshes of all states correspond."""
    cap = mesh_cap(spherical_cap(1.0, 0.5), nodes)  # has no preferred direction
    angle = np.arctan2(np.hypot(*cap.nodes[:, :2].T), cap.nodes[:, 2] + 0.75)
    along = angle / angle.max() * meridian.s_m[-1]
    s = np.concatenate([[0.0], meridian.s_m])
    r = np.interp(along, s, np.concatenate([[0.0], meridian.r_m]))
    z = np.interp(along, s, np.concatenate([meridian.z_m[:1], meridian.z_m]))
    z[cap.rim] = 0.0
    azimuth = np.arctan2(cap.nodes[:, 1], cap.nodes[:, 0])
    points = np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), z])
    return MembraneMesh(points, cap.triangles, cap.rim)
