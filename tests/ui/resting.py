"""A dome at rest and then pressed, with known gas pressure and noise."""

import time
from functools import cache

import numpy as np
from fakes import DentSource

from bubbleviz.camera import DepthCamera, MembraneView
from bubbleviz.membrane import build_mesh
from bubbleviz.recordings import Frame

REST, FRAMES = 20, 30
TENSION = 2585.5 * 0.08125 / 2.0
"""Tension of the small sensor's dome, P R / 2, N/m."""


@cache
def dented(sensor):
    """Ranges without contact, then with a growing dent; takes half a second."""
    mesh = build_mesh(sensor, 3000)
    view = MembraneView(DepthCamera.of(sensor.camera), mesh)
    away = np.linalg.norm(mesh.nodes[:, :2] - [0.02, 0.0], axis=1)
    dent = -np.exp(-((away / 0.015) ** 2)) * ~mesh.rim
    return [view.range_image(2e-3 * k * dent) for k in range(FRAMES - REST + 1)]


class RestingSource(DentSource):
    """REST frames without contact, then a dent that grows.

    Parameters
    ----------
    sensor : Sensor
    noise_m : float
    fresh : bool
        New noise whenever a frame is read, as a camera has; else the same for a frame.
    slow_s : float
        How long a frame takes to read.
    """

    def __init__(self, sensor, noise_m=1e-4, *, fresh=False, slow_s=0.0):
        super().__init__(sensor, slow_s=slow_s)
        self.name, self.times_s = "resting", np.arange(FRAMES) / 30.0
        self._noise, self._fresh = noise_m, fresh
        self._rest_pa = sensor.pneumatics.reference_pressure_pa
        self._ranges = dented(sensor)

    def __getitem__(self, index):
        self.reads += 1
        time.sleep(self._slow_s)
        pressed = max(index - REST + 1, 0)
        rng = np.random.default_rng([index, self.reads if self._fresh else 0])
        ranges = self._ranges[pressed]
        ranges = ranges + self._noise * rng.standard_normal(ranges.shape)
        return Frame(
            index,
            float(self.times_s[index]),
            self._camera.depth_image(ranges).astype(np.float32),
            self._camera.intrinsics,
            self._rest_pa + 60.0 * pressed + rng.standard_normal(),
        )


def never_written(*_, progress, **__):
    """Replaces the report by a slow one."""
    while True:
        progress("writing", 0.5)
        time.sleep(0.01)
