"""A simulated sensor as a frame source, with ground truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.camera import ColourCamera, ColourImage, DepthCamera, EncodedImage, MembraneView
from bubbleviz.errors import InputError, SolveError, check_number
from bubbleviz.files import checked_pose
from bubbleviz.inverse import area_above, touching_share
from bubbleviz.membrane import (
    MOST_FRICTION,
    Contact,
    ForwardModel,
    Gas,
    MembraneMesh,
    RubberForward,
    build_mesh,
    build_rubber,
    refinement,
)
from bubbleviz.recordings import (
    ColourAround,
    Frame,
    FrameSource,
    Moment,
    Series,
    half_step_ns,
)
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.printed_speckle import PrintedMembrane

SLIP_M = 1e-6  # motion over the object between two frames beyond which a node counts as slipping


@dataclass(frozen=True)
class Truth:
    """Ground truth of one frame; names and units as in TRUTH.npz.

    Attributes
    ----------
    displacement_m, contact_pressure_pa : (n,) array
        On the nodes of the simulation's mesh; the displacement along the rest normals.
    displacement_3d_m : (n, 3) array
        Full displacement vector.
    gas_pressure_change_pa : float
    force_n : (3,) array
        Resultant of the contact on the membrane in B.
    center_of_pressure_m : (3,) array
        In B; NaN without contact.
    patch_area_m2 : float
        Area where the linear interpolation of `touching_share` is at least one half.
    patch_mask : (H, W) bool array
        Pixels that see this area.
    traction_pa : (n, 3) array, optional
        Of the object on the membrane, force over deformed area, Pa; None if TRUTH.npz lacks it.
    torque_nm : (3,) array, optional
        Of the object on the membrane about the centre of pressure, N·m; 0 without contact.
    slip_m : (n,) array, optional
        Motion of each node over the object since the previous frame, m; NaN without friction.
    slip_share : float, optional
        Share of the contact area that slipped by more than 1 µm; NaN without friction or contact.
    """

    displacement_m: np.ndarray
    displacement_3d_m: np.ndarray
    contact_pressure_pa: np.ndarray
    gas_pressure_change_pa: float
    force_n: np.ndarray
    center_of_pressure_m: np.ndarray
    patch_area_m2: float
    patch_mask: np.ndarray
    traction_pa: np.ndarray | None = None
    torque_nm: np.ndarray | None = None
    slip_m: np.ndarray | None = None
    slip_share: float | None = None

    @classmethod
    def of(cls, contact: Contact, view: MembraneView) -> Truth:
        """Ground truth of a contact on the mesh of a view."""
        touching = touching_share(view.mesh, contact.contact_pressure_pa)
        moved = contact.displacement_3d_m
        x = view.mesh.deformed(moved)
        areas = replace(view.mesh, nodes=x).areas
        load = np.linalg.norm(contact.nodal_force_n, axis=1)
        slip = getattr(contact, "slip_m", np.full(len(load), np.nan))
        if not np.isnan(slip).any():  # with friction, the normal force alone
            load = contact.contact_pressure_pa * areas
        center, torque = np.full(3, np.nan), np.zeros(3)
        if load.sum() > 0.0:
            center = load @ x / load.sum()
            torque = np.cross(x - center, contact.nodal_force_n).sum(axis=0)
        half = 0.5 - 1e-9  # includes exactly one half
        return cls(
            displacement_m=contact.displacement_m,
            displacement_3d_m=moved,
            contact_pressure_pa=contact.contact_pressure_pa,
            gas_pressure_change_pa=contact.gas_pressure_change_pa,
            force_n=contact.nodal_force_n.sum(axis=0),
            center_of_pressure_m=center,
            patch_area_m2=area_above(view.mesh, touching, half),
            patch_mask=view.above(moved, touching, half),
            traction_pa=contact.nodal_force_n / areas[:, None],
            torque_nm=torque,
            slip_m=slip,
            slip_share=_slip_share(slip, np.where(load > 0.0, areas, 0.0)),
        )

    def force_error(self, force_n: np.ndarray) -> float:
        """Error of a force (3,) over the magnitude of the true one; NaN if that is 0."""
        size = float(np.linalg.norm(self.force_n))
        return float(np.linalg.norm(force_n - self.force_n)) / size if size > 0.0 else float("nan")


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks; 1 where both are empty."""
    union = np.count_nonzero(a | b)
    return np.count_nonzero(a & b) / union if union else 1.0


def _slip_share(slip_m: np.ndarray, touching_m2: np.ndarray) -> float:
    """Share of the contact area (n,) that slips; NaN if unknown."""
    if not touching_m2.any() or np.isnan(slip_m).any():
        return float("nan")
    return float(touching_m2[slip_m > SLIP_M].sum() / touching_m2.sum())


@runtime_checkable
class HasTruth(Protocol):
    """A source with ground truth for some or all frames."""

    def truth(self, index: int) -> Truth | None:
        """Ground truth of a frame; None if unknown."""


def truth_of(source: object, index: int) -> Truth | None:
    """Ground truth of a frame of any source; None if it has none."""
    return source.truth(index) if isinstance(source, HasTruth) else None


Model = Literal["rubber", "linear"]  # the exact membrane, or the paper's linear one

NODE_RATIO = 4  # nodes of the simulation's mesh per node of the estimator's


class SyntheticSource:
    """Frames of a rigid object moved against the membrane, computed on access.

    The membrane is solved on its own mesh, with about four times the estimator's nodes, so that the
    estimator does not invert its own discretisation. Frame k depends on the seed and k alone.

    Attributes
    ----------
    name : str
    times_s : (F,) array
    mesh : MembraneMesh
        The simulation's mesh, to which `Truth` refers.
    """

    def __init__(
        self,
        sensor: Sensor | SensorModel,
        obj: RigidObject,
        poses: np.ndarray,  # (F, 4, 4), T_B_O of every frame
        noise: DepthNoise | None = None,  # None: no noise
        rate_hz: float = 30.0,
        seed: int = 0,
        *,
        times_s: np.ndarray | None = None,  # (F,), instead of `rate_hz`
        nodes: int | None = None,  # target number of nodes of the simulation's mesh
        # membrane model; None: the exact one if the sensor has a pre-stretch, as in estimation
        model: Model | None = None,
        # Coulomb's μ between object and exact membrane; frames then depend on earlier ones
        friction: float = 0.0,
        texture: bool = False,  # whether a speckle is printed on the membrane, for colour images
    ) -> None:
        own = sensor if isinstance(sensor, SensorModel) else SensorModel.of(sensor)
        self.sensor = sensor = own.sensor
        if np.ndim(poses) != 3 or not len(poses):
            raise InputError(f"poses: shape {np.shape(poses)}; give T_B_O (frames, 4, 4)")
        self.obj, self.poses = obj, np.array([checked_pose(each) for each in poses])
        check_number("--friction", friction, 0.0, MOST_FRICTION)
        self.noise, self.seed = noise or DepthNoise(), seed
        self.name = f"{obj.name} on {sensor.name}"
        self.times_s = np.arange(len(poses)) / rate_hz if times_s is None else times_s
        self.mesh = simulation_mesh(own, nodes)
        self.camera = own.camera
        # γ0 of the sensor's mesh: a refined polyhedron has all curvature in the old edges.
        tension = own.tension_n_per_m
        gas = Gas.of(sensor.pneumatics, self.mesh)
        self._gas = gas
        self._model: ForwardModel | RubberForward
        self._friction = friction
        if model == "rubber" or (model is None and sensor.membrane.prestretch is not None):
            rubber = build_rubber(sensor, self.mesh, tension)
            self._model = RubberForward(rubber, gas)
        elif friction:
            raise InputError(
                f"friction {friction:g}: the linear membrane has no friction; choose the exact one "
                "(--model rubber)"
            )
        else:
            self._model = ForwardModel(self.mesh, tension, gas)
        self._past: list[Contact] = []
        self._path: Iterator[Contact] | None = None
        self._view = MembraneView(self.camera, self.mesh)
        self._printed = PrintedMembrane(self._view, seed) if texture else None
        self._solved = lru_cache(maxsize=300)(self._solve)

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.poses)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; IndexError outside 0 … F−1, SolveError without equilibrium."""
        contact = self.contact(index)
        ranges = self._view.range_image(contact.displacement_3d_m)
        return Frame(
            index=index,
            time_s=float(self.times_s[index]),
            depth_m=self.noise.depth_image(self.camera, ranges, self.seed, index),
            intrinsics=self.camera.intrinsics,
            gas_pressure_pa=self._gas.P0 + contact.gas_pressure_change_pa,
            find_colour=None if self._printed is None else self._colour_around(index),
        )

    def close(self) -> None:
        """Clear the cached solutions."""
        self._solved.cache_clear()
        self._past, self._path = [], None

    def contact(self, index: int) -> Contact:
        """Equilibrium of frame `index`."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} is outside 0 … {len(self) - 1} of {self.name}")
        return self._solved(index)

    def truth(self, index: int) -> Truth:
        """Ground truth of frame `index`."""
        return Truth.of(self.contact(index), self._view)

    def _colour_around(self, index: int) -> ColourAround:
        """Finds the image nearest to a time after a frame."""
        stamps_ns = np.rint(1e9 * self.times_s).astype(np.int64)
        images = Series(stamps_ns, self._colour_image)
        moment = Moment(int(stamps_ns[index]), int(stamps_ns[index]))
        return ColourAround(images, moment, float(self.times_s[index]), half_step_ns(stamps_ns))

    def _colour_image(self, index: int) -> ColourImage:
        camera, stamp_ns = ColourCamera(self.camera.intrinsics), round(1e9 * self.times_s[index])
        return ColourImage(partial(self._image, index), stamp_ns, camera=camera)

    def _image(self, index: int) -> EncodedImage:
        assert self._printed is not None
        grey = self._printed.image(self.contact(index).displacement_3d_m, index)
        height, width = grey.shape
        return EncodedImage("mono8", grey.tobytes(), width, height, width)

    def _solve(self, index: int) -> Contact:
        contact = self._pressed(index)
        if contact.rim_penetration_m > 1e-6:
            raise InputError(
                f"frame {index}: {self.obj.name} cuts {contact.rim_penetration_m:.2g} m into the"
                " clamped rim; raise the object or move it inward"
            )
        if not contact.converged:
            raise SolveError(
                f"frame {index}: no equilibrium of {self.obj.name} at this pose; press it less deep"
            )
        return contact

    def _pressed(self, index: int) -> Contact:
        if not (self._friction and isinstance(self._model, RubberForward)):
            return self._model.press(self.obj, self.poses[index])
        if self._path is None:
            self._path = self._model.follow(self.obj, self.poses, self._friction)
        while len(self._past) <= index:
            contact = next(self._path, None)
            if contact is None:
                raise SolveError(
                    f"frame {len(self._past) - 1}: no equilibrium of {self.obj.name} at this pose; "
                    "press it less deep"
                )
            self._past.append(contact)
        return self._past[index]


def simulation_mesh(model: SensorModel, nodes: int | None = None) -> MembraneMesh:
    """Mesh of a simulation: a fine mesh of an analytic surface, or a refined mesh file."""
    membrane = model.sensor.membrane
    if membrane.shape == "mesh":
        return refinement(model.mesh).mesh
    return build_mesh(model.sensor, NODE_RATIO * membrane.nodes if nodes is None else nodes)


def default_path(height_m: float, width_m: float, frames: int) -> np.ndarray:
    """Poses T_B_O (F, 4, 4) of the built-in press for a dome of given height and narrower width."""
    t = np.arange(frames) / frames
    depth = 0.25 * height_m * (ease(t, 0.12, 0.35) - ease(t, 0.75, 0.92))
    above = 0.1 * height_m * (1.0 - ease(t, 0.05, 0.12) + ease(t, 0.92, 0.98))
    turn = ease(t, 0.35, 0.75)
    round_trip = 2.0 * np.pi * turn
    radius = 0.05 * width_m
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(
        0.5 * np.pi * turn[:, None] * [0.0, 0.0, 1.0]
    ).as_matrix()
    poses[:, 0, 3] = radius * np.sin(round_trip)
    poses[:, 1, 3] = radius * (1.0 - np.cos(round_trip))
    poses[:, 2, 3] = height_m - depth + above
    return poses


def dome_size(sensor: Sensor) -> tuple[float, float]:
    """Height of the dome and the narrower width of its rim, m."""
    mesh = build_mesh(sensor)
    rim = np.ptp(mesh.nodes[mesh.rim, :2], axis=0)
    return float(mesh.nodes[:, 2].max()), float(rim.min())


def ease(t: np.ndarray, start: float, end: float) -> np.ndarray:
    """Smooth rise from 0 to 1 between `start` and `end`."""
    s = np.clip((t - start) / (end - start), 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


class LoopedSource:
    """Frames of a short looped simulation, each simulated once; only the noise of loops differs.

    Reading backwards starts a new round.
    """

    def __init__(
        self,
        source: FrameSource,
        camera: DepthCamera,
        noise: DepthNoise | None = None,  # of each loop; None: that of the source, in all of them
    ) -> None:
        self._source, self._camera, self._noise = source, camera, noise
        self._frames: dict[int, Frame] = {}
        self._round, self._last = 0, 0
        self.name, self.times_s = source.name, source.times_s

    def __len__(self) -> int:
        """Count the frames of a loop."""
        return len(self._source)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index` of the present loop."""
        if index not in self._frames:
            self._frames[index] = self._source[index]
        frame = self._frames[index]
        self._round += index < self._last
        self._last = index
        if self._noise is None:
            return frame
        ranges = self._camera.range_image(frame.depth_m).astype(float)
        depth = self._noise.depth_image(self._camera, ranges, self._round, index)
        return replace(frame, depth_m=depth)

    def truth(self, index: int) -> Truth | None:
        """Ground truth of a frame, the same in every loop."""
        return truth_of(self._source, index)

    def close(self) -> None:
        """Close the source."""
        self._source.close()
