"""Alternative registrations of an object: whole cloud ([6] of the paper) and other libraries.

Both are imported inside the functions: small_gicp is an optional extra, and Open3D is imported
after `TriangleScene` has disabled its drawing modules.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from bubbleviz.membrane import ObjectSurface

SAMPLES = 20_000  # points of the object's surface that the libraries register to

_ITERATIONS = 60  # at most; chosen


def has_small_gicp() -> bool:
    """Whether small_gicp is installed."""
    return importlib.util.find_spec("small_gicp") is not None


class CloudRegistration:
    """Point-to-plane registration of points to a sampled object by a library."""

    def __init__(self, model: ObjectSurface, reach_m: float) -> None:
        self._points, self._normals = model.sample(SAMPLES)
        self._reach = reach_m
        self._gicp: Any = None

    def open3d(self, points: np.ndarray, start: np.ndarray) -> np.ndarray:
        """T_B_O (4, 4) by Open3D from points (k, 3) in B."""
        from open3d import geometry, utility
        from open3d.pipelines import registration

        target = geometry.PointCloud(utility.Vector3dVector(self._points))
        target.normals = utility.Vector3dVector(self._normals)
        source = geometry.PointCloud(utility.Vector3dVector(points))
        found = registration.registration_icp(
            source,
            target,
            self._reach,
            np.linalg.inv(start),
            registration.TransformationEstimationPointToPlane(),
            registration.ICPConvergenceCriteria(max_iteration=_ITERATIONS),
        )
        return np.linalg.inv(found.transformation)

    def small_gicp(self, points: np.ndarray, start: np.ndarray) -> np.ndarray:
        """T_B_O (4, 4) by small_gicp from points (k, 3) in B."""
        import small_gicp

        if self._gicp is None:
            target = small_gicp.PointCloud(self._points)
            tree = small_gicp.KdTree(target)
            small_gicp.estimate_normals_covariances(target, tree, num_neighbors=12)
            self._gicp = target, tree
        target, tree = self._gicp
        found = small_gicp.align(
            target,
            small_gicp.PointCloud(points),
            tree,
            init_T_target_source=np.linalg.inv(start),
            registration_type="PLANE_ICP",
            max_correspondence_distance=self._reach,
            num_threads=1,
            max_iterations=_ITERATIONS,
            translation_epsilon=1e-6,
            rotation_epsilon=1e-5,
        )
        return np.linalg.inv(found.T_target_source)
