"""A simulated sensor as a frame source, with ground truth."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.colour.colour_image import ColourCamera, ColourImage, EncodedImage
from bubbleviz.errors import InputError, SolveError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.gaps import usual_step
from bubbleviz.membrane.forward_model import Contact, ForwardModel
from bubbleviz.membrane.gap import GapFinder
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.reference_mesh import build_mesh, build_rubber
from bubbleviz.membrane.refine import refine
from bubbleviz.membrane.rubber_model.friction_forward import FrictionForward
from bubbleviz.membrane.rubber_model.rubber_forward import RubberForward
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.printed_speckle import PrintedMembrane, Speckle
from bubbleviz.simulation.truth import Truth

Model = Literal["rubber", "linear"]  # the exact membrane, or the paper's linear one

FINER = 4  # nodes of the simulation's mesh for every node of the estimator's

_LEVELS, _LOOKS = 3, 40
"""How often that mesh is refined under edges, and the number of poses looked at for them."""


class SyntheticSource:
    """Frames of a rigid object moved against the membrane, made when asked for.

    The membrane is solved on a mesh of its own, about four times finer than the estimator's, so
    that estimating is not merely undoing. Frame k depends on the seed and k alone.

    Attributes
    ----------
    name : str
    times_s : (F,) array
    mesh : MembraneMesh
        The simulation's mesh, which `Truth` is on.
    """

    def __init__(
        self,
        sensor: Sensor,
        obj: RigidObject,
        poses: np.ndarray,  # (F, 4, 4), T_B_O of every frame
        noise: DepthNoise | None = None,  # None by default
        rate_hz: float = 30.0,
        seed: int = 0,
        *,
        times_s: np.ndarray | None = None,  # (F,), in place of `rate_hz`
        nodes: int | None = None,  # target number of nodes of the simulation's mesh
        sharp: bool = False,  # refine that mesh where edges of the object press; see `sharpened`
        # membrane to press into; the exact one where the sensor's pre-stretch is known, as it is
        # estimated with
        model: Model | None = None,
        # Coulomb's μ between object and membrane, which must be the exact one. Frames then follow
        # from those before.
        friction: float = 0.0,
        # printed on the membrane; frames have its image, made when it is asked for
        texture: Speckle | None = None,
    ) -> None:
        self.sensor, self.obj, self.poses = sensor, obj, np.asarray(poses, dtype=np.float64)
        if self.poses.ndim != 3 or self.poses.shape[1:] != (4, 4) or not len(self.poses):
            raise InputError("poses: give at least one 4×4 transform T_B_O")
        self.noise, self.seed = noise or DepthNoise(), seed
        self.name = f"{obj.name} on {sensor.name}"
        self.times_s = np.arange(len(poses)) / rate_hz if times_s is None else times_s
        own = SensorModel.of(sensor)
        mesh = simulation_mesh(own, nodes)
        self.mesh = sharpened(mesh, obj, self.poses) if sharp else mesh
        self.camera = own.camera
        # γ0 of the sensor's own mesh: a refined polyhedron has its curvature in the old edges.
        tension = own.tension_n_per_m
        gas = Gas.of(sensor.pneumatics, self.mesh)
        self._gas = gas
        self._model: ForwardModel | RubberForward | FrictionForward
        if model == "rubber" or (model is None and sensor.membrane.prestretch is not None):
            rubber = build_rubber(sensor, self.mesh, tension)
            self._model = (
                FrictionForward(rubber, gas, friction) if friction else RubberForward(rubber, gas)
            )
        elif friction:
            raise InputError(
                f"friction {friction:g}: the linear membrane has none; choose the model rubber, or "
                "a sensor file with a prestretch"
            )
        else:
            self._model = ForwardModel(self.mesh, tension, gas)
        self._past: list[Contact] = []
        self._path: Iterator[Contact] | None = None
        self._view = MembraneView(self.camera, self.mesh)
        self._printed = None if texture is None else PrintedMembrane(texture, self._view)
        self._solved = lru_cache(maxsize=300)(self._solve)

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.poses)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; IndexError outside 0 … F−1, SolveError without equilibrium."""
        contact = self.contact(index)
        ranges = self._view.range_image(contact.displacement_3d_m)
        depth = self.camera.depth_image(self.noise.apply(ranges, self.seed, index))
        return Frame(
            index=index,
            time_s=float(self.times_s[index]),
            depth_m=depth.astype(np.float32),
            intrinsics=self.camera.intrinsics,
            gas_pressure_pa=self._gas.P0 + contact.gas_pressure_change_pa,
            find_colour=None if self._printed is None else partial(self._find_colour, index),
        )

    def close(self) -> None:
        """Forget what was solved."""
        self._solved.cache_clear()
        self._past, self._path = [], None

    def contact(self, index: int) -> Contact:
        """Equilibrium of frame `index`."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        return self._solved(index)

    def truth(self, index: int) -> Truth:
        """What is true of frame `index`."""
        return Truth.of(self.contact(index), self._view)

    def _find_colour(self, index: int, after_s: float) -> ColourImage | None:
        """Image of the frame nearest to a time after another, within half a period."""
        wanted_s = self.times_s[index] + after_s
        nearest = int(np.abs(self.times_s - wanted_s).argmin())
        period_s = usual_step(np.diff(self.times_s)) or np.inf
        if abs(self.times_s[nearest] - wanted_s) > 0.5 * period_s:
            return None
        camera = ColourCamera(self.camera.intrinsics)
        time_s = float(self.times_s[nearest])
        return ColourImage(partial(self._image, nearest), round(1e9 * time_s), time_s, camera)

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
                " clamped rim; raise it or move it inward"
            )
        if not contact.converged:
            raise SolveError(f"frame {index}: no equilibrium of {self.obj.name} at this pose")
        return contact

    def _pressed(self, index: int) -> Contact:
        if not isinstance(self._model, FrictionForward):
            return self._model.press(self.obj, self.poses[index])
        if self._path is None:
            self._path = self._model.follow(self.obj, self.poses)
        while len(self._past) <= index:
            contact = next(self._path, None)
            if contact is None:
                raise SolveError(
                    f"frame {len(self._past) - 1}: no equilibrium of {self.obj.name} at this pose"
                )
            self._past.append(contact)
        return self._past[index]


def simulation_mesh(model: SensorModel, nodes: int | None = None) -> MembraneMesh:
    """Mesh to simulate on: an analytic surface meshed finely, a mesh file's facets cut in four."""
    membrane = model.sensor.membrane
    if membrane.shape == "mesh":
        return refine(model.mesh)
    return build_mesh(model.sensor, FINER * membrane.nodes if nodes is None else nodes)


def sharpened(mesh: MembraneMesh, obj: RigidObject, poses: np.ndarray) -> MembraneMesh:
    """The mesh, finer where edges of an object press at some of the poses (F, 4, 4).

    Whole nodes touch or do not, so that on a coarse mesh the outline of a flat face catches on the
    nodes as it turns, by some degrees. The membrane's shape is truer then, and so are poses; which
    single node carries pressure is not, for the surface at rest still has its curvature in the
    coarse edges: patches are better known on an even mesh.
    """
    some = poses[:: max(1, len(poses) // _LOOKS)]
    for _ in range(_LEVELS):
        finder, edge = GapFinder(mesh), mesh.edge_length
        cut = np.zeros(len(mesh.triangles), bool)
        for pose in some:
            gaps = np.minimum(finder.gaps(obj, pose), 1e3)[mesh.triangles]
            cut |= (gaps.min(axis=1) < edge) & (np.ptp(gaps, axis=1) > edge)
        mesh = refine(mesh, cut)
    return mesh


def default_press(
    sensor: Sensor,
    frames: int = 150,  # frames of one round, contact-free at both ends so that it loops
    rate_hz: float = 30.0,
) -> SyntheticSource:
    """Press of the built-in live sensor: approach, press, move and turn, withdraw."""
    noise = DepthNoise(relative=sensor.camera.noise_relative)
    obj = load_object("two_legged_toy")
    height, width = dome_size(sensor)
    poses = default_path(height, width, frames)
    return SyntheticSource(sensor, obj, poses, noise, rate_hz)


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
    """Rise from 0 to 1 between `start` and `end`, smooth at both."""
    s = np.clip((t - start) / (end - start), 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)
