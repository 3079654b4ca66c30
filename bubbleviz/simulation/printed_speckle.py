"""Colour images of a speckle pattern printed on the simulated membrane."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import ndimage

from bubbleviz.camera import MembraneView
from bubbleviz.membrane import MembraneMesh

_VOXELS, _VOXELS_PER_BLOT = 96, 4
"""Side and resolution of the periodic cube of noise that the speckle is a section of."""
_DARK, _BRIGHT, _EDGE = 60.0, 190.0, 3.0  # grey levels of ink and paper, steepness between them
_BACKGROUND = 100.0  # grey level beside the membrane
_BLOT_PX = 8.0  # size of a blot at the centre of the membrane; as on the real sensor
_NOISE_STREAM = 3  # random stream of the seed, after those of `DepthNoise`
GREY_NOISE = 2.0  # σ of the grey levels (0 … 255)


class PrintedMembrane:
    """Renders the speckle, which is fixed to the material, on the deformed membrane.

    It is lit from the camera: brightest where it faces it.
    """

    def __init__(
        self,
        view: MembraneView,  # of the printed mesh at rest
        seed: int = 0,  # of pattern and noise
        noise: float = GREY_NOISE,
    ) -> None:
        self._view, self._seed, self._sigma = view, seed, noise
        middle_m = np.linalg.norm(view.mesh.nodes.mean(axis=0) - view.camera.center)
        self._blot_m = _BLOT_PX * middle_m / view.camera.intrinsics.fx

    def image(
        self,
        displacement_m: np.ndarray,  # (n,) or (n, 3) array
        index: int,  # of the frame, for its noise
    ) -> np.ndarray:
        """Grey image (H, W), uint8, at a displacement as in `MembraneMesh.deformed`."""
        mesh = self._view.mesh
        hits = self._view.hits(displacement_m)
        grey = self.grey(hits.values(mesh.nodes, mesh.triangles))
        deformed = MembraneMesh(mesh.deformed(displacement_m), mesh.triangles, mesh.rim)
        normals = hits.values(deformed.normals, mesh.triangles)
        rays = self._view.camera.directions[hits.ray]
        facing = np.einsum("kx,kx->k", normals, rays) / np.linalg.norm(normals, axis=1)
        grey *= 0.5 + 0.5 * np.clip(facing, 0.0, 1.0)
        image = np.full(self._view.shape, _BACKGROUND)
        image.ravel()[hits.ray] = grey
        random = np.random.default_rng([self._seed, index, _NOISE_STREAM])
        image += self._sigma * random.standard_normal(image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def grey(self, points_m: np.ndarray) -> np.ndarray:
        """Grey level (k,) of material points (k, 3), by their position at rest in B, m."""
        voxels = points_m.T * (_VOXELS_PER_BLOT / self._blot_m)
        ink = ndimage.map_coordinates(self._noise, voxels, order=1, mode="grid-wrap")
        return _DARK + (_BRIGHT - _DARK) * (0.5 + 0.5 * np.tanh(_EDGE * ink))

    @cached_property
    def _noise(self) -> np.ndarray:
        """Smooth periodic noise in a cube, of unit variance, float32."""
        random = np.random.default_rng(self._seed)
        white = random.standard_normal((_VOXELS,) * 3).astype(np.float32)
        smooth = ndimage.gaussian_filter(white, 0.4 * _VOXELS_PER_BLOT, mode="wrap")
        return np.asarray(smooth / smooth.std())
