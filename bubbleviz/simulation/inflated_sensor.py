"""Frames of an untouched sensor inflated to some pressure."""

from __future__ import annotations

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.frames.frame import Frame
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.simulation.depth_noise import DepthNoise


class InflatedSensor:
    """Source of frames of a membrane at rest.

    Attributes
    ----------
    pressures_pa : (F,) array or None
        Recorded with the frames, absolute, Pa.
    """

    def __init__(
        self,
        name: str,
        camera: DepthCamera,
        membrane: MembraneMesh,  # as the pressure bulges it
        gas_pressure_pa: float | None,  # absolute, as it is recorded
        noise: DepthNoise,
        frames: int = 40,
        seed: int = 0,
        pressure_noise_pa: float = 5.0,  # σ of each frame's pressure, Pa
    ) -> None:
        self.name, self.camera, self.noise, self.seed = name, camera, noise, seed
        self.times_s = np.arange(frames) / 30.0
        self._range_m = MembraneView(camera, membrane).rest_range
        self.pressures_pa: np.ndarray | None = None
        if gas_pressure_pa is not None:
            shaken = np.random.default_rng([seed, 3]).standard_normal(frames)
            self.pressures_pa = gas_pressure_pa + pressure_noise_pa * shaken

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.times_s)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; IndexError outside 0 … F−1."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        depth = self.camera.depth_image(self.noise.apply(self._range_m, self.seed, index))
        return Frame(
            index=index,
            time_s=float(self.times_s[index]),
            depth_m=depth.astype(np.float32),
            intrinsics=self.camera.intrinsics,
            gas_pressure_pa=None if self.pressures_pa is None else float(self.pressures_pa[index]),
        )

    def close(self) -> None:
        """Nothing to close."""
