"""Truth of every press, from the forward model on a mesh that no estimator uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.frames.frame import Frame
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.synthetic_source import SyntheticSource, Truth
from bubbleviz.study.presses import Press, made

TRUTH_NODES = 12_500  # about 15 times the estimator's 800


@dataclass(frozen=True)
class Sighting:
    """A press as the camera would see it without noise, and what is true of it.

    Attributes
    ----------
    press : Press
    truth : Truth
    range_m : (H, W) array
        Range along each ray, NaN where it misses the membrane.
    """

    press: Press
    truth: Truth
    range_m: np.ndarray


class TruthBank:
    """Solves presses on one fine mesh and keeps what it has solved.

    Parameters
    ----------
    sensor : Sensor
    seed : int
        Of the poses.
    nodes : int
        Of the truth's mesh.
    """

    def __init__(self, sensor: Sensor, seed: int, nodes: int = TRUTH_NODES) -> None:
        self.sensor, self.seed = sensor, seed
        far = np.eye(4)
        far[2, 3] = 1.0
        self._source = SyntheticSource(sensor, made("sphere"), far[None], nodes=nodes)
        self.camera = self._source.camera
        self.rest_range_m = self._range()
        self._sightings: dict[Press, Sighting] = {}

    @property
    def mesh(self) -> MembraneMesh:
        """The mesh that truths are on."""
        return self._source.mesh

    def sighting(self, press: Press) -> Sighting:
        """Solve a press, or remember it.

        Raises
        ------
        InputError, SolveError
            The pose cuts the rim, or has no equilibrium.
        """
        if press not in self._sightings:
            self._source.obj = made(press.object_name)
            self._source.poses = press.pose(self.mesh, self.seed)[None]
            self._source.close()
            self._sightings[press] = Sighting(press, self._source.truth(0), self._range())
        return self._sightings[press]

    def frame(
        self, sighting: Sighting, noise_relative: float, index: int, stride: int = 1
    ) -> Frame:
        """Frame number `index` of a press: new noise for every number; every stride-th pixel."""
        noisy = DepthNoise(relative=noise_relative).apply(sighting.range_m, self.seed, index)
        depth = self.camera.depth_image(noisy)[::stride, ::stride]
        return Frame(index, index / 30.0, np.ascontiguousarray(depth, np.float32))

    def _range(self) -> np.ndarray:
        return self.camera.range_image(self._source[0].depth_m).astype(np.float64)
