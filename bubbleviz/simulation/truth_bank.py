"""Ground truth of presses on one membrane, by a forward model on a mesh no estimator uses."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.camera import MembraneView
from bubbleviz.errors import SolveError
from bubbleviz.files import whole_file
from bubbleviz.membrane import MembraneMesh
from bubbleviz.processes import MEMORY_LIMIT_BYTES, WorkerProcess
from bubbleviz.recordings import Frame
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.presses import Press, made
from bubbleviz.simulation.rubber_truth import Presses, RubberTruth
from bubbleviz.simulation.synthetic_source import Truth


@dataclass(frozen=True)
class Sighting:
    """A press as the camera would see it without noise, and what is true of it."""

    press: Press
    mesh: MembraneMesh  # reference surface that the truth is on
    truth: Truth
    range_m: np.ndarray  # (H, W), range along each ray, NaN where it misses the membrane


class TruthBank:
    """Solves presses and keeps what it has solved."""

    def __init__(
        self,
        presses: Presses,
        seed: int,  # of the poses
        folder: Path | None = None,  # keeps the truths of one membrane and seed from run to run
        # wall time of a press, beyond which it counts as having no equilibrium
        limit_s: float | None = None,
    ) -> None:
        self._presses, self.seed, self._folder, self._limit_s = presses, seed, folder, limit_s
        self.camera, self.mesh = presses.camera, presses.mesh
        self.rest_range_m = MembraneView(self.camera, self.mesh).rest_range
        self.rest_pressure_pa = presses.pneumatics.reference_pressure_pa
        self._sightings: dict[Press, Sighting] = {}

    def sighting(self, press: Press) -> Sighting:
        """Solve a press, or remember it.

        Raises InputError, SolveError: the pose cuts the rim, or has no equilibrium.
        """
        if press not in self._sightings:
            self._sightings[press] = self._kept(press)
        return self._sightings[press]

    def pose(self, press: Press) -> np.ndarray:
        """T_B_O (4, 4) of a press."""
        return press.pose(self.mesh, self.seed)

    def frame(self, sighting: Sighting, noise: DepthNoise, index: int, stride: int = 1) -> Frame:
        """Frame number `index` of a press: new noise for every number; every stride-th pixel."""
        return self.seen(sighting.range_m, noise, index, stride)

    def seen(
        self,
        range_m: np.ndarray,
        noise: DepthNoise,
        index: int,
        stride: int = 1,
        gas_pressure_pa: float | None = None,
    ) -> Frame:
        """Frame of ranges (H, W), m, with the gas pressure where it is measured."""
        noisy = noise.apply(range_m, self.seed, index)
        depth = np.ascontiguousarray(self.camera.depth_image(noisy)[::stride, ::stride], np.float32)
        return Frame(index, index / 30.0, depth, gas_pressure_pa=gas_pressure_pa)

    def _kept(self, press: Press) -> Sighting:
        if self._folder is None:
            return self._sighting(press, self._made(press))
        name = Path(press.object_name).stem
        path = self._folder / f"{name}_{round(1e6 * press.depth_m)}um_{self.seed}.npz"
        if not path.exists():
            _save(self._sighting(press, self._made(press)), path)
        return _load(press, path)

    def _made(self, press: Press) -> RubberTruth:
        work = self._presses, press, self.pose(press)
        if self._limit_s is None:
            return _pressed(*work)
        with WorkerProcess(MEMORY_LIMIT_BYTES) as worker:
            outcome = worker.call(_pressed, *work, limit_s=self._limit_s)
        if outcome.kind != "returned":
            raise SolveError(outcome.detail)
        truth: RubberTruth = outcome.value
        return truth

    def _sighting(self, press: Press, made: RubberTruth) -> Sighting:
        view = MembraneView(self.camera, made.mesh)
        return Sighting(press, made.mesh, Truth.of(made.contact, view), made.range_m)


def _pressed(presses: Presses, press: Press, T_B_O: np.ndarray) -> RubberTruth:
    return presses.press(made(press.object_name), T_B_O)


def _save(sighting: Sighting, path: Path) -> None:
    mesh, truth = vars(sighting.mesh), asdict(sighting.truth)
    arrays = {f"mesh_{name}": mesh[name] for name in ("nodes", "triangles", "rim")}
    arrays |= {f"truth_{name}": value for name, value in truth.items()}
    arrays["range_m"] = sighting.range_m
    with whole_file(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def _load(press: Press, path: Path) -> Sighting:
    with np.load(path) as file:
        arrays = dict(file.items())

    def part(prefix: str) -> dict[str, Any]:
        named = {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
        return {k: v if v.ndim else float(v) for k, v in named.items()}

    mesh, truth = MembraneMesh(**part("mesh_")), Truth(**part("truth_"))
    return Sighting(press, mesh, truth, arrays["range_m"])


def noise_name(noise: DepthNoise) -> str:
    """White noise in words."""
    parts = [
        f"{1e3 * noise.absolute_m:g} mm" if noise.absolute_m else "",
        f"{100 * noise.relative:g} %" if noise.relative else "",
    ]
    return " and ".join(filter(None, parts)) or "none"
