"""Study of pose error and run time on simulated rubber, from perturbed initial poses."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.membrane import MembraneMesh, ObjectSurface
from bubbleviz.pipeline import Pipeline
from bubbleviz.pose import (
    MIN_RADIUS_M,
    Directions,
    ImageFit,
    Precision,
    PressedMembrane,
    about,
    contact_points,
    directions,
    motion_between,
    moved,
    precision_of,
    rows,
)
from bubbleviz.recordings import Frame
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    TRUTH_NODES,
    DepthNoise,
    Press,
    RubberPresses,
    SimulatedPress,
    TruthBank,
    rubber_sensor,
    study_object,
)
from bubbleviz.study.harness import (
    Case,
    Column,
    Report,
    Study,
    Table,
    at_most,
    averages,
    groups,
    summaries,
)

# Pose error over the directions of motion that the true contact determines, modulo symmetry.
#
# A direction is determined if the normals of the true contact, at the true pose and the sensor's
# noise, fix it to 0.24 mm at the patch's edge (`bubbleviz.pose.registration`), independently of any
# estimate.


_MIN_FACING = np.cos(np.radians(45.0))  # between normals of object and membrane in contact


@dataclass(frozen=True, kw_only=True)
class PoseErrors:
    """Difference between a pose and the true one, as motion of the patch; infinite without one."""

    error_m: float = np.inf  # over the determined directions
    error_rad: float = np.inf
    whole_m: float = np.inf  # over all six
    whole_rad: float = np.inf


@dataclass(frozen=True)
class TrueContact:
    """The true contact, and the motions of the object that it determines."""

    T_B_O: np.ndarray  # (4, 4)
    center: np.ndarray  # (3,), of the true patch
    radius_m: float
    directions: Directions


class PoseMetrics:
    """Computes errors of poses of one object, for the precision of a sensor at its noise."""

    def __init__(self, model: ObjectSurface, precision: Precision) -> None:
        self._model, self._precision = model, precision

    def touching(
        self, mesh: MembraneMesh, displacement_m: np.ndarray, pressure_pa: np.ndarray, T: np.ndarray
    ) -> TrueContact:
        """True contact for displacement (n, 3), pressure (n,) and object pose T (4, 4)."""
        touching = np.flatnonzero(pressure_pa > 0.0)
        points = mesh.deformed(displacement_m)[touching]
        areas = mesh.areas[touching]
        center = areas @ points / areas.sum()
        radius = float(np.sqrt(areas @ np.sum((points - center) ** 2, axis=1) / areas.sum()))
        normals = self._model.closest((points - T[:3, 3]) @ T[:3, :3]).normal @ T[:3, :3].T
        facing = np.einsum("ij,ij->i", normals, mesh.normals[touching]) < -_MIN_FACING
        J = rows(normals[facing], points[facing], center)
        surface = (J.T * (self._precision.per_area * areas[facing])) @ J
        return TrueContact(T, center, max(radius, MIN_RADIUS_M), directions(surface, radius))

    def equivalents(self, T_B_O: np.ndarray, true: TrueContact) -> list[np.ndarray]:
        """The true pose, and the nearest pose in which the object looks the same."""
        symmetry = self._model.nearest_symmetry(true.T_B_O[:3, :3].T @ T_B_O[:3, :3])
        return [true.T_B_O] if symmetry is None else [true.T_B_O, true.T_B_O @ symmetry]

    def errors(self, T_B_O: np.ndarray | None, true: TrueContact) -> PoseErrors:
        """Errors of a pose (4, 4), relative to the closest symmetric equivalent of the true one."""
        if T_B_O is None:
            return PoseErrors()
        equivalents = self.equivalents(T_B_O, true)
        candidates = [motion_between(each, T_B_O, true.center) for each in equivalents]
        arm = np.array([1.0, 1.0, 1.0, *3 * [true.radius_m]])
        found = true.directions
        basis = (arm[:, None] * found.motions)[:, found.determined]
        scaled = np.array(candidates) * arm
        known = scaled @ basis @ basis.T
        # Symmetric poses are equal in the determined directions; take the closest in the others.
        best = int(np.argmin(np.linalg.norm(known, axis=1) + 0.05 * np.linalg.norm(scaled, axis=1)))
        return PoseErrors(
            error_m=float(np.linalg.norm(known[best, :3])),
            error_rad=float(np.linalg.norm(known[best, 3:]) / true.radius_m),
            whole_m=float(np.linalg.norm(scaled[best, :3])),
            whole_rad=float(np.linalg.norm(scaled[best, 3:]) / true.radius_m),
        )


START_M, START_RAD = 3e-3, np.radians(8.0)  # errors of initial poses


def wrong_pose(T_B_O: np.ndarray, center: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Initial pose (4, 4) that is off by 3 mm and 8° in random directions."""
    errors = random.standard_normal((2, 3))
    errors *= np.array([[START_M], [START_RAD]]) / np.linalg.norm(errors, axis=1)[:, None]
    return moved(T_B_O, errors.ravel(), center)


MIN_DEPTH_M, MAX_DEPTH_M = 0.007, 0.012  # of the presses
FRAMES = 4  # of each press, with different noise
LIMIT_S = 300.0  # to simulate a press


@dataclass(frozen=True)
class Grid:
    """Parameters of a pose study."""

    objects: tuple[str, ...] = (
        *("cylinder", "bar", "torus", "two_spheres", "frustum", "two_legged_toy", "bridge"),
        *("hex_nut", "sphere"),
    )
    presses: int = 3  # random presses of each object
    starts: int = 3  # initial poses of each press, with errors of 3 mm and 8°
    noise_relative: float = 0.01
    truth_nodes: int = TRUTH_NODES
    seed: int = 7


def quick_grid() -> Grid:
    """A subset that runs in half a minute."""
    return Grid(objects=("cylinder", "two_spheres"), presses=1, starts=2)


@dataclass(frozen=True)
class Row:
    """The last frame of one press, tracked from one initial pose.

    `error_m` and `error_rad` are over the directions that the contact's normals determine, `seen_m`
    and `seen_rad` over those that one image of the exact membrane at the true pose determines (to
    0.24 mm at the patch's edge, at the sensor's noise), like sliding of a face with visible edges.
    All are modulo symmetry, and infinite without a pose.
    """

    object_name: str
    depth_m: float
    status: str
    determined: int
    seen: int
    error_m: float
    error_rad: float
    seen_m: float
    seen_rad: float
    first_ms: float
    next_ms: float


def pose_study(sensor: Sensor, grid: Grid) -> Study:
    """Every press of every object, from every initial pose."""
    own = SensorModel.of(rubber_sensor(sensor))
    bank = TruthBank(RubberPresses.of(own, grid.truth_nodes), grid.seed, limit_s=LIMIT_S)
    pipeline, cases = Pipeline(own), list[Case]()
    for name in grid.objects:
        bench = _Bench(pipeline, bank, name, grid)
        random = np.random.default_rng([grid.seed, *name.encode()])
        for depth in random.uniform(MIN_DEPTH_M, MAX_DEPTH_M, grid.presses):
            press = Press(name, float(depth), False)
            run = partial(bench.rows, press, random)
            cases.append(Case(f"{name} {1e3 * depth:.1f} mm", run))
    return Study("pose", Row, cases, partial(report_of, grid))


class _Bench:
    """Tracks one object."""

    def __init__(self, pipeline: Pipeline, bank: TruthBank, name: str, grid: Grid) -> None:
        self._pipeline, self._bank, self._grid = pipeline, bank, grid
        self._model = ObjectSurface(study_object(name))
        self._precision = precision_of(pipeline.estimator)
        self._metrics = PoseMetrics(self._model, self._precision)

    def rows(self, press: Press, random: np.random.Generator) -> list[Row]:
        """Rows of one press, from every initial pose."""
        simulated, grid = self._bank.simulate(press), self._grid
        self._pipeline.restart()
        truth = simulated.truth
        touched = simulated.mesh, truth.displacement_3d_m, truth.contact_pressure_pa
        true = self._metrics.touching(*touched, simulated.T_B_O)
        observed, rows = self._observed(simulated, true), []
        for number in range(grid.starts):
            start = wrong_pose(true.T_B_O, true.center, random)
            self._pipeline.track(self._model.obj, start)
            rows.append(self._row(press, simulated.range_m, true, observed, number))
        return rows

    def _observed(self, simulated: SimulatedPress, true: TrueContact) -> TrueContact:
        """The contact, with the directions that one image determines."""
        depth = self._pipeline.camera.depth_image(simulated.range_m).astype(np.float32)
        result = self._pipeline.process(Frame(0, 0.0, depth), frozenset({"estimate", "patch"}))
        if result.estimate is None or result.patch is None:
            return true
        contact = contact_points(self._pipeline.mesh, result.estimate, result.patch)
        own = self._pipeline.model
        pressed = PressedMembrane(own.rubber, own.gas, self._model)
        fit = ImageFit(self._pipeline.estimator.observer, pressed)
        image = None if contact is None else fit.predicted(true.T_B_O, contact)
        if image is None:
            return true
        J = image.jacobian @ about(true.center, image.press.center)
        sigma = self._grid.noise_relative * float(np.nanmedian(simulated.range_m))
        return replace(
            true, directions=directions(image.pixel.shape[1] / sigma**2 * J.T @ J, true.radius_m)
        )

    def _row(
        self,
        press: Press,
        range_m: np.ndarray,
        true: TrueContact,
        observed: TrueContact,
        number: int,
    ) -> Row:
        grid, camera = self._grid, self._pipeline.camera
        noise = DepthNoise(relative=grid.noise_relative)
        times = []
        for k in range(FRAMES):
            depth = noise.depth_image(camera, range_m, grid.seed + number, k)
            result = self._pipeline.process(Frame(k, k / 30.0, depth), frozenset({"pose"}))
            times.append(result.times_ms.get("pose", np.nan))
        pose = result.pose
        found = pose.T_B_O if pose is not None and pose.status == "ok" else None
        errors, in_image = (self._metrics.errors(found, each) for each in (true, observed))
        return Row(
            press.object_name,
            press.depth_m,
            "none" if pose is None else pose.status,
            determined=int(true.directions.determined.sum()),
            seen=int(observed.directions.determined.sum()),
            first_ms=times[0],
            next_ms=float(np.median(times[1:])),
            error_m=errors.error_m,
            error_rad=errors.error_rad,
            seen_m=in_image.error_m,
            seen_rad=in_image.error_rad,
        )


AVERAGES = averages("error_m", "error_rad", "seen_m", "seen_rad", "first_ms", "next_ms") | {
    f"{name}_worst": (name, np.max) for name in ("seen_m", "seen_rad")
}
_DEGREES = float(np.degrees(1.0))
_COLUMNS = (
    Column("object", "object_name"),
    Column("starts", "count"),
    Column("mm", "error_m", ".2f", 1e3),
    Column("°", "error_rad", ".1f", _DEGREES),
    Column("seen mm", "seen_m", ".2f", 1e3),
    Column("worst", "seen_m_worst", ".2f", 1e3),
    Column("seen °", "seen_rad", ".1f", _DEGREES),
    Column("worst", "seen_rad_worst", ".1f", _DEGREES),
    Column("first ms", "first_ms", ".0f"),
    Column("next ms", "next_ms", ".0f"),
)


def report_of(grid: Grid, rows: list[Row]) -> Report:
    """Errors by object, over the directions that normals and that an image determine."""
    points = summaries(rows, ("object_name",), AVERAGES)
    title = (
        "Rubber; initial poses off by 3 mm and 8°; errors over the directions that the contact, "
        "then (seen) that the image determines"
    )
    targets = []
    if rows:
        errors_m, worst_rad = [row.seen_m for row in rows], max(row.seen_rad for row in rows)
        name = f"{len(rows)} starts"
        targets = [
            at_most(f"{name}: median error in mm", 1e3 * np.median(errors_m), 0.4),
            at_most(f"{name}: worst error in mm", 1e3 * max(errors_m), 1.0),
            at_most(f"{name}: worst error in °", np.degrees(worst_rad), 3.0),
        ]
    table = Table("points", points, _COLUMNS, title)
    return Report([table], targets, {"grid": asdict(grid)}, plot=partial(plot, rows))


def plot(rows: list[Row], figure: Figure) -> None:
    """Error against run time, one point per initial pose."""
    left, right = figure.subplots(1, 2)
    panels = ((left, "seen_m", 1e3, "mm", 1.0), (right, "seen_rad", _DEGREES, "°", 3.0))
    for axes, name, scale, unit, limit in panels:
        for (obj,), own in groups(rows, "object_name").items():
            errors = [scale * getattr(row, name) for row in own]
            axes.scatter([row.next_ms for row in own], errors, s=30, alpha=0.8, label=obj)
        axes.axhline(limit, color="tab:green", lw=0.8, label="target, worst")
        axes.set(xlabel="pose of a following frame, ms (median)", ylim=(0.0, 3.0 * limit))
        axes.set(ylabel=f"error over observable directions, {unit}")
