"""Smallest detectable press at a false-alarm rate of 1 in 1,000 contact-free frames.

A ball is pressed along the membrane's normal into simulated rubber. A frame is an alarm if its
force exceeds a level: the 99.9th percentile of the force in contact-free frames, which is 0 N if
at most one in a thousand shows a force.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.inverse import GAS_NOISE
from bubbleviz.membrane import refinement
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, HeldFrames
from bubbleviz.sensor import Sensor
from bubbleviz.simulation import (
    DepthNoise,
    RubberPresses,
    SimulatedPress,
    TruthBank,
    noise_name,
    study_object,
)
from bubbleviz.study.accuracy import LINEAR, RUBBER, Grid, Setup, specimen
from bubbleviz.study.harness import Case, Column, Report, Study, Table
from bubbleviz.zeros import zeros_of

FOUND = 0.95
ALARMS = 1e-3
_MIN_DEPTH_M, _RATIO, _DEPTHS = 1e-4, 1.25, 20
"""Tested depths: 0.1 mm to 7 mm in steps of 25 %."""
_NOISES, _AT_REST = 10_000, 5_000
"""Noises drawn for a depth at most, and the first of them for the half second before."""
_FINER = (0.2, 0.13, 0.09)
"""Radii of mesh refinement around the contact, relative to the rim's: the smallest dents are
smaller than a triangle."""


@dataclass(frozen=True)
class DetectionGrid:
    """Cases of the detection study."""

    specimens: tuple[str, ...] = ("sensor", "dome λ 1.2")
    setups: tuple[Setup, ...] = (RUBBER, LINEAR)
    noises: tuple[DepthNoise, ...] = (DepthNoise(absolute_m=1e-4), DepthNoise(relative=0.01))
    places: tuple[float, ...] = (
        0.0,
        0.4,
        0.75,
    )  # distance from the axis / rim radius
    object_name: str = "sphere"  # pressed along the normal
    frames: int = 60  # of a press
    rest_frames: int = 1_000  # without contact
    truth_nodes: int = 1_500
    seed: int = 7


def quick_detection_grid() -> DetectionGrid:
    """A few seconds' run: too few contact-free frames to resolve one alarm in a thousand."""
    return DetectionGrid(
        ("dome λ 1.2",), (RUBBER,), places=(0.0,), frames=20, rest_frames=50, truth_nodes=800
    )


@dataclass(frozen=True)
class Limit:
    """The smallest press found in 95 % of frames.

    `depth_m`, `force_n` and `found` are NaN if no depth is found. `alarms` counts the contact-free
    frames with a force, `level_n` is the force above which a frame is an alarm.
    """

    specimen: str
    setup: str
    noise: str
    place: float
    gas_measured: bool
    rest_frames: int
    alarms: int
    level_n: float
    depth_m: float = np.nan
    force_n: float = np.nan
    found: float = np.nan


def detection_study(sensor: Sensor, grid: DetectionGrid) -> Study:
    """The limit of every setup, noise and place, with and without the gas pressure."""
    cases = [Case(name, partial(_limits, sensor, grid, name)) for name in grid.specimens]
    return Study("detection", Limit, cases, report_of)


def _limits(sensor: Sensor, grid: DetectionGrid, name: str) -> list[Limit]:
    own = specimen(name, sensor, Grid(truth_nodes=grid.truth_nodes, seed=grid.seed))
    assert isinstance(own.presses, RubberPresses)
    ladders = {place: Ladder(own.presses, place, grid) for place in grid.places}
    found = list[Limit]()
    for noise, setup in product(grid.noises, grid.setups):
        pipeline = setup.pipeline(own.model(noise))
        for gas in (False, True):
            found += limits_of(name, setup, Alarm(pipeline, noise, gas, grid), ladders)
    return found


def limits_of(
    name: str, setup: Setup, alarm: Alarm, ladders: dict[float, Ladder]
) -> Iterator[Limit]:
    """Limits of one setup at every place."""
    rest = alarm.forces(next(iter(ladders.values())), None)
    level = float(np.sort(rest)[-1 - int(ALARMS * len(rest))])
    counts, noise = (len(rest), int(np.count_nonzero(rest))), noise_name(alarm.noise)
    for place, ladder in ladders.items():
        what = name, setup.label, noise, place, alarm.gas_measured
        yield _smallest(Limit(*what, *counts, level), alarm, ladder)


def _smallest(limit: Limit, alarm: Alarm, ladder: Ladder) -> Limit:
    """The limit with the smallest depth that is found, by bisection."""
    low, high, best = -1, _DEPTHS, limit
    while high - low > 1:
        step = (low + high) // 2
        found = float(np.mean(alarm.forces(ladder, step) > limit.level_n))
        if found >= FOUND:
            force = float(np.linalg.norm(ladder.press(step).truth.force_n))
            depth = ladder.depth_m(step)
            high, best = step, replace(limit, depth_m=depth, force_n=force, found=found)
        else:
            low = step
    return best


class Ladder:
    """Presses at one place, of increasing depth."""

    def __init__(self, presses: RubberPresses, place: float, grid: DetectionGrid) -> None:
        mesh = presses.mesh
        radius = float(np.abs(mesh.nodes[:, 0]).max())
        node = int(np.argmin(np.hypot(mesh.nodes[:, 0] - place * radius, mesh.nodes[:, 1])))
        self._at, self._normal = mesh.nodes[node], mesh.normals[node]
        for share in _FINER:
            middles = mesh.nodes[mesh.triangles].mean(axis=1)
            mesh = refinement(
                mesh, np.linalg.norm(middles - self._at, axis=1) < share * radius
            ).mesh
        self._presses = replace(presses, mesh=mesh)
        self._object = study_object(grid.object_name)
        self._pressed: dict[int, SimulatedPress] = {}
        self.bank = TruthBank(self._presses, grid.seed)

    def depth_m(self, step: int) -> float:
        """Depth along the normal, m."""
        return float(_MIN_DEPTH_M * _RATIO**step)

    def press(self, step: int) -> SimulatedPress:
        """Equilibrium at a step."""
        if step not in self._pressed:
            pose = np.eye(4)
            pose[:3, :3] = Rotation.align_vectors(self._normal, [0.0, 0.0, 1.0])[0].as_matrix()
            pose[:3, 3] = self._at - self.depth_m(step) * self._normal
            self._pressed[step] = self._presses.press(self._object, pose)
        return self._pressed[step]


class Alarm:
    """Forces of a pipeline in noisy frames, each solved from rest, after half a second at rest.

    The gas pressure may be measured, with the precision of a barometer.
    """

    def __init__(
        self, pipeline: Pipeline, noise: DepthNoise, gas_measured: bool, grid: DetectionGrid
    ) -> None:
        self._pipeline, self.noise, self.gas_measured, self._grid = (
            pipeline, noise, gas_measured, grid,
        )  # fmt: skip

    def forces(self, ladder: Ladder, step: int | None) -> np.ndarray:
        """|F| (frames,) at a step, or without contact; 0 N if none is found."""
        bank, count = ladder.bank, self._grid.frames
        ranges, gas = bank.rest_range_m, bank.rest_pressure_pa
        if step is None:
            first, count = 0, self._grid.rest_frames
        else:
            pressed, first = ladder.press(step), (step + 1) * _NOISES
            ranges = pressed.range_m
            gas = bank.rest_pressure_pa + pressed.truth.gas_pressure_change_pa
        random = np.random.default_rng([bank.seed, first])
        measured = gas + GAS_NOISE * bank.rest_pressure_pa * random.standard_normal(count)
        zeros = zeros_of(self._at_rest(bank, first), self._pipeline)
        frames = (
            bank.frame(
                ranges,
                self.noise,
                first + k,
                gas_pressure_pa=float(measured[k]) if self.gas_measured else None,
            )
            for k in range(count)
        )
        return np.array(
            [
                self._force(zeros.applied(replace(frame, time_s=k / 30.0)))
                for k, frame in enumerate(frames)
            ]
        )

    def _at_rest(self, bank: TruthBank, first: int) -> HeldFrames:
        gas = bank.rest_pressure_pa if self.gas_measured else None
        return bank.frames_at_rest(self.noise, first + _AT_REST, gas_pressure_pa=gas)

    def _force(self, frame: Frame) -> float:
        self._pipeline.restart()
        result = self._pipeline.process(frame, frozenset({"estimate", "patch"}))
        if result.estimate is None or result.patch is None or result.estimate.status != "ok":
            return 0.0
        return float(np.linalg.norm(result.patch.force_n))


_COLUMNS = (
    *(Column(name, name) for name in ("specimen", "setup", "noise", "gas_measured")),
    Column("place / rim", "place", "g"),
    Column("mm", "depth_m", ".2f", 1e3),
    Column("N", "force_n", ".3f"),
    Column("found %", "found", ".0f", 100),
    Column("alarms", "alarms"),
    Column("of frames", "rest_frames"),
)


def report_of(limits: Sequence[Limit]) -> Report:
    """Every limit."""
    title = "Smallest press of a ball found in 95 % of frames, at one false alarm in 1,000"
    return Report([Table("limits", [asdict(limit) for limit in limits], _COLUMNS, title)])
