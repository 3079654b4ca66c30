"""Ground truth of presses into one membrane, on a mesh that no estimator uses."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.camera import MembraneView
from bubbleviz.errors import SolveError
from bubbleviz.files import whole_file
from bubbleviz.membrane import MembraneMesh
from bubbleviz.processes import MEMORY_LIMIT_BYTES, WorkerProcess
from bubbleviz.recordings import Frame, HeldFrames
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.presses import Press, study_object
from bubbleviz.simulation.rubber_truth import Presses, SimulatedPress
from bubbleviz.simulation.synthetic_source import Truth
from bubbleviz.zeros import ZERO_FRAMES


class TruthBank:
    """Solves presses and caches the solutions."""

    def __init__(
        self,
        presses: Presses,
        seed: int,  # of the poses
        folder: Path | None = None,  # cache on disk, for one membrane and seed
        limit_s: float | None = None,  # wall time after which a press has no equilibrium
    ) -> None:
        self._presses, self.seed, self._folder, self._limit_s = presses, seed, folder, limit_s
        self.camera, self.mesh = presses.camera, presses.mesh
        self.rest_range_m = MembraneView(self.camera, self.mesh).rest_range
        self.rest_pressure_pa = presses.pneumatics.reference_pressure_pa
        self._cache: dict[Press, SimulatedPress] = {}

    def simulate(self, press: Press) -> SimulatedPress:
        """Solve a press, or return the cached solution.

        Raises InputError, SolveError: the pose cuts the rim, or has no equilibrium.
        """
        if press not in self._cache:
            self._cache[press] = self._simulated(press)
        return self._cache[press]

    def pose(self, press: Press) -> np.ndarray:
        """T_B_O (4, 4) of a press."""
        return press.pose(self.mesh, self.seed)

    def frame(
        self,
        range_m: np.ndarray,
        noise: DepthNoise,
        index: int,
        gas_pressure_pa: float | None = None,
    ) -> Frame:
        """Frame of ranges (H, W), m, with the noise of an `index`."""
        depth = noise.depth_image(self.camera, range_m, self.seed, index)
        return Frame(index, index / 30.0, depth, gas_pressure_pa=gas_pressure_pa)

    def frames_at_rest(
        self,
        noise: DepthNoise,
        first: int,  # index of the noise of the first one
        gas_pressure_pa: float | None = None,
    ) -> HeldFrames:
        """Half a second without contact, ending at 0 s, for `zeros_of`."""
        frames = [
            self.frame(self.rest_range_m, noise, first + k, gas_pressure_pa)
            for k in range(ZERO_FRAMES)
        ]
        times = np.arange(-ZERO_FRAMES, 0) / 30.0
        return HeldFrames([replace(f, time_s=t) for f, t in zip(frames, times, strict=True)])

    def _simulated(self, press: Press) -> SimulatedPress:
        if self._folder is None:
            return self._solved(press)
        name = Path(press.object_name).stem
        path = self._folder / f"{name}_{round(1e6 * press.depth_m)}um_{self.seed}.npz"
        if not path.exists():
            _save(self._solved(press), path)
        return _load(path)

    def _solved(self, press: Press) -> SimulatedPress:
        solve, args = self._presses.press, (study_object(press.object_name), self.pose(press))
        if self._limit_s is None:
            return solve(*args)
        with WorkerProcess(MEMORY_LIMIT_BYTES) as worker:
            outcome = worker.call(solve, *args, limit_s=self._limit_s)
        if outcome.kind != "returned":
            raise SolveError(outcome.detail)
        simulated: SimulatedPress = outcome.value
        return simulated


def _save(simulated: SimulatedPress, path: Path) -> None:
    mesh, truth = vars(simulated.mesh), asdict(simulated.truth)
    arrays = {f"mesh_{name}": mesh[name] for name in ("nodes", "triangles", "rim")}
    arrays |= {f"truth_{name}": value for name, value in truth.items()}
    arrays |= {"range_m": simulated.range_m, "T_B_O": simulated.T_B_O}
    with whole_file(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def _load(path: Path) -> SimulatedPress:
    with np.load(path) as file:
        arrays = dict(file.items())

    def part(prefix: str) -> dict[str, Any]:
        named = {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
        return {k: v if v.ndim else float(v) for k, v in named.items()}

    mesh, truth = MembraneMesh(**part("mesh_")), Truth(**part("truth_"))
    return SimulatedPress(arrays["T_B_O"], mesh, truth, arrays["range_m"])


def noise_name(noise: DepthNoise) -> str:
    """Magnitude of the noise as text."""
    parts = [
        f"{1e3 * noise.absolute_m:g} mm" if noise.absolute_m else "",
        f"{100 * noise.relative:g} %" if noise.relative else "",
    ]
    return " and ".join(filter(None, parts)) or "none"
