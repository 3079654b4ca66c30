"""Per-pixel images of an identification, for the report and the window."""

from __future__ import annotations

import numpy as np

from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.tension import local_tension
from bubbleviz.camera import RayCaster

_BLUR = 0.1  # of the dome's size: below it the spread is the facets'


def before_after(found: Identification) -> tuple[np.ndarray, np.ndarray]:
    """The last contact-free frame less the surface, before rectification and after it.

    Ranges (H, W), m; NaN outside the pixels in use.
    """
    frame = found.camera.range_image(found.samples.depth_m[-1])
    pixels, line = found.pixels, found.pixels.line
    straight = frame if line is None else line.straighten(frame)
    before, after = (
        np.where(pixels.mask, image - found.modelled_range_m, np.nan) for image in (frame, straight)
    )
    return before, after - pixels.bias_m


def local_tension_image(found: Identification) -> np.ndarray:
    """γ0 by the balance of each neighbourhood as the camera sees it, (H, W), N/m."""
    scale = _BLUR * float(np.sqrt(found.mesh.areas.sum()))
    field = local_tension(found.mesh, found.tension.gauge_pressure_pa, scale)
    camera, mesh = found.camera, found.mesh
    hits = RayCaster(camera.center, camera.directions, mesh.triangles).cast(
        mesh.nodes, mesh.normals
    )
    image = np.full(found.pixels.mask.shape, np.nan)
    at = field[mesh.triangles[hits.triangle]]
    image.ravel()[hits.ray] = np.einsum("ij,ij->i", hits.barycentric, at)
    return image
