"""The membrane of one frame as a trimesh scene, for notebooks and other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.membrane import level_line
from bubbleviz.output.exporter import Shape
from bubbleviz.output.series import COLOURS, HIGHEST_PRESSURE, UNKNOWN_COLOUR
from bubbleviz.result import Result
from bubbleviz.sensor_model import SensorModel

if TYPE_CHECKING:
    import trimesh

ARROW = 0.5  # of the membrane's width, the length of the force's arrow


def scene_of(model: SensorModel, result: Result) -> trimesh.Scene:
    """Deformed membrane coloured by contact pressure, outline of the patch, and force, in B, m."""
    import trimesh  # 0.2 s
    from matplotlib import colormaps  # not at import: it takes long

    mesh, shape = model.mesh, Shape.of(model.mesh, result)
    share = shape.contact_pressure_pa / (
        HIGHEST_PRESSURE * model.sensor.pneumatics.gauge_pressure_pa
    )
    colours = colormaps[COLOURS].with_extremes(bad=UNKNOWN_COLOUR)(share, bytes=True)
    membrane = trimesh.Trimesh(shape.points_m, mesh.triangles, vertex_colors=colours, process=False)
    scene = trimesh.Scene({"membrane": membrane})
    patch = result.trusted_patch
    if patch is not None and patch.area_m2 > 0.0:
        edge = trimesh.load_path(level_line(shape.points_m, mesh.corners, patch.level))
        edge.colors = np.full((len(edge.entities), 4), 255, np.uint8)
        scene.add_geometry(edge, geom_name="patch")
        width = float(np.ptp(mesh.nodes[:, 0]))
        arrow = _arrow(patch.center_of_pressure_m, patch.force_n, ARROW * width)
        scene.add_geometry(arrow, geom_name="force")
    return scene


def _arrow(tip_m: np.ndarray, direction: np.ndarray, length_m: float) -> trimesh.Trimesh:
    """Red arrow that ends at a point."""
    import trimesh  # as in `scene_of`

    direction = direction / np.linalg.norm(direction)
    neck = tip_m - 0.25 * length_m * direction
    shaft = trimesh.creation.cylinder(0.02 * length_m, segment=[tip_m - length_m * direction, neck])
    turned = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], direction)
    turned[:3, 3] = neck
    head = trimesh.creation.cone(0.05 * length_m, 0.25 * length_m, transform=turned)
    arrow = trimesh.util.concatenate([shaft, head])
    arrow.visual.vertex_colors = (255, 0, 0, 255)
    return arrow
