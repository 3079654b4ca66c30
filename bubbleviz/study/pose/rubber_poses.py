"""Pose on honest rubber: presses by the exact forward model, followed from starts that are off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.errors import InputError, SolveError
from bubbleviz.frames.frame import Frame
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.pose.contact_points import contact_points
from bubbleviz.pose.depth_image.image_fit import ImageFit
from bubbleviz.pose.depth_image.pressed_membrane import PressedMembrane
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.pose.observability import directions
from bubbleviz.pose.pose_options import ImageOptions
from bubbleviz.pose.rigid_motion import about, moved
from bubbleviz.pose.tracker import precision_of
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.study.pose.pose_errors import PoseJudge, TrueContact
from bubbleviz.study.pose.rubber_truth import TRUTH_NODES, RubberPresses, rubber_sensor
from bubbleviz.study.presses import Press, made
from bubbleviz.study.truth_bank import Sighting, TruthBank

START_M, START_RAD = 3e-3, np.radians(8.0)  # how far off starts are
SHALLOWEST_M, DEEPEST_M = 0.007, 0.012  # of the presses
FRAMES = 4  # of each press, with noise of their own
LIMIT_S = 300.0  # of a press whose equilibrium is looked for

_PRODUCTS: frozenset[Product] = frozenset({"pose"})


@dataclass(frozen=True)
class RubberGrid:
    """What runs.

    Attributes
    ----------
    objects : tuple of str
    presses, starts : int
        Random presses of each object, and starts of each press, off by 3 mm and 8°.
    noise_relative : float
    truth_nodes, seed : int
    """

    objects: tuple[str, ...] = (
        "cylinder", "bar", "torus", "two_spheres", "frustum", "two_legged_toy", "bridge", "hex_nut",
        "sphere",
    )  # fmt: skip
    presses: int = 3
    starts: int = 3
    noise_relative: float = 0.01
    truth_nodes: int = TRUTH_NODES
    seed: int = 7


def quick_rubber_grid() -> RubberGrid:
    """Half a minute's worth."""
    return RubberGrid(objects=("cylinder", "two_spheres"), presses=1, starts=2)


@dataclass(frozen=True)
class RubberTrial:
    """The last of some frames of one press, followed from one start.

    `error_m` and `error_rad` are over the directions that the contact's normals determine, `seen_m`
    and `seen_rad` over those that one image of the exact membrane at the true pose determines, to
    0.4 mm at the patch's edge and the sensor's noise: where a face with visible edges has slid to.
    All are modulo symmetry.
    """

    object_name: str
    depth_m: float
    status: str
    determined: int = 0
    seen: int = 0
    error_m: float = np.nan
    error_rad: float = np.nan
    seen_m: float = np.nan
    seen_rad: float = np.nan
    first_ms: float = np.nan
    next_ms: float = np.nan


@dataclass(frozen=True)
class RubberStudy:
    """All trials, and what was left out and why."""

    grid: RubberGrid
    trials: list[RubberTrial]
    omitted: list[str]


def run_rubber_study(
    sensor: Sensor, grid: RubberGrid, tick: Callable[[str], None] = lambda _: None
) -> RubberStudy:
    """Run a grid; `tick` is called with an object's name for each of its presses."""
    own = SensorModel.of(rubber_sensor(sensor))
    bank = TruthBank(RubberPresses.of(own, grid.truth_nodes), grid.seed, limit_s=LIMIT_S)
    trials: list[RubberTrial] = []
    omitted: list[str] = []
    for name in grid.objects:
        bench = _Bench(Pipeline(own), ObjectModel(made(name)))
        random = np.random.default_rng([grid.seed, *name.encode()])
        for depth in random.uniform(SHALLOWEST_M, DEEPEST_M, grid.presses):
            press = Press(name, float(depth), False)
            try:
                trials += bench.trials(bank.sighting(press), bank.pose(press), grid, random)
            except (InputError, SolveError) as error:
                omitted.append(f"{name} {1e3 * depth:.1f} mm: {error}")
            tick(name)
    return RubberStudy(grid, trials, omitted)


class _Bench:
    """Follows one object."""

    def __init__(self, pipeline: Pipeline, model: ObjectModel) -> None:
        self._pipeline, self.model = pipeline, model
        self._judge = PoseJudge(model, precision_of(pipeline.estimator))
        own, options = pipeline.model, ImageOptions()
        pressed = PressedMembrane(own.rubber, own.gas, model, options.press)
        self._image = ImageFit(pipeline.estimator.observer, pressed, options)

    def trials(
        self,
        sighting: Sighting,
        T_B_O: np.ndarray,
        grid: RubberGrid,
        random: np.random.Generator,
    ) -> list[RubberTrial]:
        """From every start, the object truly at T_B_O (4, 4)."""
        truth = sighting.truth
        true = self._judge.touching(
            sighting.mesh, truth.displacement_3d_m, truth.contact_pressure_pa, T_B_O
        )
        seen = self._seen(sighting, true, grid.noise_relative)
        trials = []
        for start in range(grid.starts):
            ways = random.standard_normal((2, 3))
            ways *= np.array([[START_M], [START_RAD]]) / np.linalg.norm(ways, axis=1)[:, None]
            T = moved(true.T_B_O, ways.ravel(), true.center)
            trials.append(self._trial(sighting, true, seen, T, grid, start))
        return trials

    def _seen(self, sighting: Sighting, true: TrueContact, noise_relative: float) -> TrueContact:
        """The contact with the directions that an image of it determines."""
        depth = self._pipeline.camera.depth_image(sighting.range_m).astype(np.float32)
        result = self._pipeline.process(Frame(0, 0.0, depth), frozenset({"estimate", "patch"}))
        if result.estimate is None or result.patch is None:
            return true
        contact = contact_points(self._pipeline.mesh, result.estimate, result.patch)
        self._image.forget()
        image = None if contact is None else self._image.predicted(true.T_B_O, contact)
        if image is None:
            return true
        J = image.jacobian @ about(true.center, image.center)
        sigma = noise_relative * float(np.nanmedian(sighting.range_m))
        return replace(true, directions=directions(image.every / sigma**2 * J.T @ J, true.radius_m))

    def _trial(
        self,
        sighting: Sighting,
        true: TrueContact,
        seen: TrueContact,
        start: np.ndarray,
        grid: RubberGrid,
        number: int,
    ) -> RubberTrial:
        self._pipeline.follow(self.model.obj, start)
        noise, camera = DepthNoise(relative=grid.noise_relative), self._pipeline.camera
        times = []
        for k in range(FRAMES):
            ranges = noise.apply(sighting.range_m, grid.seed + number, k)
            depth = camera.depth_image(ranges).astype(np.float32)
            result = self._pipeline.process(Frame(k, k / 30.0, depth), _PRODUCTS)
            times.append(result.times_ms.get("pose", np.nan))
        pose = result.pose
        trial = RubberTrial(
            sighting.press.object_name,
            sighting.press.depth_m,
            "none" if pose is None else pose.status,
            determined=int(true.directions.determined.sum()),
            seen=int(seen.directions.determined.sum()),
            first_ms=times[0],
            next_ms=float(np.median(times[1:])),
        )
        if pose is None or pose.status != "ok":
            return trial
        errors = self._judge.errors(pose.T_B_O, true)
        all_seen = self._judge.errors(pose.T_B_O, seen)
        return replace(
            trial,
            error_m=errors.error_m,
            error_rad=errors.error_rad,
            seen_m=all_seen.error_m,
            seen_rad=all_seen.error_rad,
        )
