"""The pipeline: runs the stages that the requested products need."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from bubbleviz.camera import DepthCamera, Intrinsics
from bubbleviz.errors import InputError
from bubbleviz.inverse import (
    LINEAR,
    PAPER,
    RUBBER,
    SOLVER_NAMES,
    ConstantTension,
    ContactRefiner,
    Estimator,
    EstimatorOptions,
    PatchFinder,
    RubberBubble,
    mesh_limits,
    without_small,
)
from bubbleviz.membrane import build_rubber, rest_stress, varied_rubber
from bubbleviz.plugins import plugin, plugin_names
from bubbleviz.recordings import Frame, SeenColour, Texture
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel

if TYPE_CHECKING:
    from bubbleviz.pose import ObjectPatchFinder, PoseTracker
    from bubbleviz.shear import (
        FlowField,
        SlipFinder,
        SlipStart,
        TractionEstimator,
        TractionOptions,
        TractionStart,
    )

_T = TypeVar("_T")
_GOLDEN = 0.5 * (3.0 - 5.0**0.5)
"""Shift of a lattice from row to row over its period: no small multiple is near a whole."""

Product = Literal[
    "estimate", "fine_contact", "patch", "pixel_mask", "cloud", "residual", "pose", "object_patch",
    "flow", "traction", "slip", "texture",
    "depth_image", "change_image", "residual_image", "noise_image", "used_image", "colour_image",
    "flow_image", "kappa_curve", "components",
]  # fmt: skip

LOOKS: dict[Product, tuple[Product, ...]] = {
    **dict.fromkeys(("depth_image", "change_image", "noise_image", "used_image"), ()),
    "residual_image": ("estimate",),
    "colour_image": (),
    "flow_image": ("estimate", "flow"),  # an estimate tells frames without contact
    "kappa_curve": ("estimate",),
    "components": ("estimate", "patch"),
}
"""Closer looks for the panels, and the products that each is made of."""

SHEAR: frozenset[Product] = frozenset({"traction", "slip"})
"""What depth and optical flow tell together."""
OF_OBJECT: frozenset[Product] = frozenset({"pose", "object_patch"})
"""What is made where there is an object to look for."""
OF_COLOUR: frozenset[Product] = frozenset({"flow", "traction", "slip", "texture", "colour_image"})
"""Products that the colour image of a frame is decoded for."""

FlowOf = Callable[[Frame], "FlowField | None"]
"""Optical flow of a frame's colour image from the contact-free one; None where there is none."""

SETTLED, SETTLED_WITHIN = 1e-3, 8
"""Change of the contact pressure over its largest that is no change, and solves until then at most;
two to four are usual."""


@dataclass(frozen=True)
class FrameOptions:
    """Choices that may differ from frame to frame; those of the estimator are fixed with it."""

    # patch threshold as a multiple of the mean contact pressure (V-C); None for the physical one of
    # `PatchFinder`
    kappa: float | None = None
    least_area_m2: float = 0.0  # parts of the patch smaller than this are left out
    # most points of the cloud, spread evenly over the image; None for all
    cloud_points: int | None = None
    # whether the contact is refined for the patch, where its mesh limits it. The rule of κ does not
    # use that; the window has it nevertheless, to change rules without solving again.
    fine_contact: bool = True


class Pipeline:
    """Frame in, the products asked for out; each frame is started where the last one ended."""

    def __init__(self, model: SensorModel, options: EstimatorOptions | None = None) -> None:
        # mesh: reference surface
        self.model, self.mesh, self.camera = model, model.mesh, model.camera
        self.options = options or EstimatorOptions()
        self.counts: Counter[str] = Counter()  # how often each stage ran, by stage name
        self.tracker: PoseTracker | None = None  # of the object to look for, see `follow`
        self._start: Any = None  # of the estimator's own kind
        self.flow_of: FlowOf | None = None  # optical flow of a frame, see `watch_texture`
        self._colour_camera = self.camera
        self._traction_options: TractionOptions | None = None
        self._traction_start: TractionStart | None = None
        self._slip_start: SlipStart | None = None

    @classmethod
    def of(
        cls,
        sensor: Sensor,
        intrinsics: Intrinsics | None = None,
        options: EstimatorOptions | None = None,
    ) -> Pipeline:
        """Pipeline of a sensor file; parameters and errors as of `SensorModel.of`."""
        nodes = None if options is None else options.nodes
        return cls(SensorModel.of(sensor, intrinsics, nodes), options)

    @cached_property
    def estimator(self) -> Estimator:
        """The inverse solver; built when the first frame needs it."""
        model = self.model
        observer = model.observer(self.options.block)
        known = model.sensor.membrane.prestretch is not None
        if self.options.solver == RUBBER or (self.options.solver is None and known):
            tension = model.tension_n_per_m
            stress = rest_stress(model.sensor, model.mesh)
            material = model.sensor, model.mesh, tension, self.options.rim_slack_m, stress
            rubber, varied = build_rubber(*material), varied_rubber(*material)
            return Estimator(observer, RubberBubble(rubber, model.gas, varied), self.options)
        film = ConstantTension(model.mesh, model.tension_n_per_m, model.gas)
        if self.options.solver == PAPER:
            from bubbleviz.inverse import PaperEstimator  # only needed here

            return PaperEstimator(observer, film, self.options)
        if self.options.solver in (None, LINEAR):
            return Estimator(observer, film, self.options)
        if (plugged := plugin("solvers", self.options.solver)) is not None:
            made: Estimator = plugged(model, self.options)
            return made
        names = ", ".join([*SOLVER_NAMES, *plugin_names("solvers")])
        raise InputError(f"{self.options.solver}: no such solver; choose one of {names}")

    def process(
        self, frame: Frame, products: frozenset[Product], options: FrameOptions | None = None
    ) -> Result:
        """Run the stages that `products` need on one frame.

        Raises InputError: the image is not of the camera's size.
        """
        self._check_size(frame)
        options, needed = options or FrameOptions(), stages(products)
        times: dict[str, float] = {}
        result = Result(self.paired(frame))

        def run(name: Product, result: Result) -> Result:
            with self._timed(name, times):
                return _STAGES[name].run(self, result, options)

        with self._timed("total", times), ThreadPoolExecutor(1) as beside:
            # OpenCV holds no lock of Python's: a second core finds the flow during the estimate
            flow = beside.submit(run, "flow", result) if "flow" in needed else None
            for name in _STAGES:
                if name == "flow" and flow is not None:
                    result = replace(result, flow=flow.result().flow)
                elif name in needed and self._makes(name, options):
                    result = run(name, result)
        return self.look(replace(result, times_ms=times), products, options)

    def look(
        self,
        result: Result,
        products: frozenset[Product],
        options: FrameOptions | None = None,  # of its patch
        truth: np.ndarray | None = None,  # (H, W) bool, true pixels of the patch, in a simulation
    ) -> Result:
        """The result with those of `products` that are `LOOKS`, made of what it has."""
        looks = products & LOOKS.keys()
        if not looks:
            return result
        from bubbleviz.diagnostics import inspection  # the panels alone need it

        self.counts.update(f"look {name.removesuffix('_image')}" for name in looks)
        kappa = None if options is None else options.kappa
        return replace(result, inspection=inspection(self, result, looks, kappa, truth))

    def _makes(self, name: Product, options: FrameOptions) -> bool:
        """Whether there is what a product is made by, and it is wanted."""
        if name == "fine_contact":
            return options.fine_contact and self._refiner is not None
        return name not in OF_OBJECT or self.tracker is not None

    def paired(self, frame: Frame) -> Frame:
        """Frame whose colour image is that of the sensor's delay of colour."""
        delay_s = self.model.sensor.camera.colour_delay_s
        return frame if frame.colour_delay_s == delay_s else replace(frame, colour_delay_s=delay_s)

    def restart(self) -> None:
        """Forget the warm start: the next frame is solved from rest."""
        self._start = self._traction_start = self._slip_start = None

    def settle(self, frame: Frame) -> None:
        """Have the next frame start where this one ends, whatever came before it.

        A frame's estimate depends a little on where it is started: linearisation and support are
        kept while they serve. From rest, and on from its own end until the contact pressure stands,
        a frame has one answer.

        Raises InputError: the image is not of the camera's size.
        """
        self._check_size(frame)
        start: Any = None  # of the estimator's own kind
        before = np.zeros(0)
        for _ in range(SETTLED_WITHIN):
            estimate, start = self._estimated(frame, start)
            pressure = estimate.contact_pressure_pa
            if before.size and np.abs(pressure - before).max() <= SETTLED * pressure.max():
                break
            before = pressure
        self._start = start

    def is_untouched(self, frame: Frame) -> bool:
        """Whether a frame's depth image alone, without the gas pressure, says that nothing touches.

        Raises InputError: the image is not of the camera's size.
        """
        self._check_size(frame)
        return self.estimator.is_untouched(frame.depth_m)

    def estimate_aside(self, frame: Frame) -> Estimate:
        """Estimate of a frame that the next one is not started from.

        Raises InputError: the image is not of the camera's size.
        """
        self._check_size(frame)
        return self._estimated(frame, self._start)[0]

    def _estimated(self, frame: Frame, start: Any) -> tuple[Estimate, Any]:
        pressure, sigma = frame.gas_pressure_pa, frame.gas_sigma_pa
        return self.estimator.estimate(frame.depth_m, pressure, start, sigma)

    def prepare(self, products: frozenset[Product]) -> None:
        """Build the solvers now, so that the first frame does not wait for them."""
        needed = stages(products)
        if "estimate" in needed:
            _ = self.estimator
        if "patch" in needed:
            _ = self._finder, self.model.view
        if "residual" in needed:
            _ = self.model.view.at_rest
        if "traction" in needed:
            _ = self.traction_estimator

    def follow(self, obj: RigidObject | None, start: np.ndarray | None = None) -> None:
        """Track an object from the next frame on, or none.

        Parameters
        ----------
        obj : RigidObject or None
        start : (4, 4) array, optional
            T_B_O in the first of them; searched for when None.

        Raises
        ------
        InputError
            The object has no area, or is in other units than the bubble.
        """
        self.__dict__.pop("_object_patch_finder", None)
        if obj is None:
            self.tracker = None
            return
        from bubbleviz.pose import PoseTracker  # open3d takes long to load

        self.tracker = PoseTracker(self.estimator, obj, start, membrane=self.model.rubber)

    def watch_texture(
        self,
        # of a frame; None where there is no colour, so that depth is left alone
        flow_of: FlowOf | None,
        # colour camera; the depth camera where not given, as for images aligned to depth
        camera: DepthCamera | None = None,
        options: TractionOptions | None = None,
    ) -> None:
        """Measure traction with friction and slip by optical flow from the next frame on."""
        self.flow_of, self._colour_camera = flow_of, camera or self.camera
        self._traction_options = options
        self._traction_start = self._slip_start = None
        for name in ("traction_estimator", "_slip_finder"):
            self.__dict__.pop(name, None)

    @cached_property
    def traction_estimator(self) -> TractionEstimator:
        """The inverse with friction; built when the first frame needs it.

        Raises InputError: the estimator is not of the exact membrane.
        """
        from bubbleviz.shear import TractionEstimator  # only needed here

        if self.estimator.solver_name != RUBBER:
            raise InputError(
                f"sensor {self.model.sensor.name}: shear takes the exact membrane; choose "
                "--solver rubber, or identify the sensor's prestretch"
            )
        return TractionEstimator(self.estimator, self._colour_camera, self._traction_options)

    @cached_property
    def _slip_finder(self) -> SlipFinder:
        from bubbleviz.shear import SlipFinder  # only needed here

        held, resolution = self.estimator.held_pressure_pa, self.estimator.resolution_m
        return SlipFinder(self.traction_estimator.flow_observer, self.mesh, held, resolution)

    def patch(
        self, estimate: Estimate, options: FrameOptions | None = None, *, pixel_mask: bool = False
    ) -> Patch:
        """Patch of an estimate, without solving again."""
        options = options or FrameOptions()
        patch = self.whole_patch(estimate, options.kappa)
        if options.least_area_m2 > 0.0:
            patch = without_small(self.mesh, estimate, patch, options.least_area_m2)
        return self._with_pixels(estimate, patch) if pixel_mask else patch

    def whole_patch(self, estimate: Estimate, kappa: float | None = None) -> Patch:
        """Patch of an estimate with all its parts, however small."""
        return self._finder.find(estimate, kappa)

    @cached_property
    def _finder(self) -> PatchFinder:
        return PatchFinder(self.mesh, self.estimator.held_pressure_pa, self.estimator.resolution_m)

    @cached_property
    def _refiner(self) -> ContactRefiner | None:
        """None where a finer mesh is not known of, not wanted, or of no use."""
        estimator = self.estimator
        refined = self.options.fine_contact and estimator.solver_name in (RUBBER, LINEAR)
        return ContactRefiner(self.model, estimator) if refined and mesh_limits(estimator) else None

    def _estimate_stage(self, result: Result, options: FrameOptions) -> Result:
        frame = result.frame
        estimate, self._start = self._estimated(frame, self._start)
        if frame.gas_sigma_pa and estimate.trusted:  # what comes after counts from the found zero
            found = self.model.gas.P0 + estimate.gas_pressure_change_pa
            frame = replace(frame, gas_pressure_pa=found, gas_sigma_pa=0.0)
        return replace(result, estimate=estimate, frame=frame)

    def _fine_contact_stage(self, result: Result, options: FrameOptions) -> Result:
        estimate = _made(result.estimate)
        fine = _made(self._refiner).refine(result.frame.depth_m, estimate)
        return replace(result, estimate=replace(estimate, fine=fine))

    def _patch_stage(self, result: Result, options: FrameOptions) -> Result:
        return replace(result, patch=self.patch(_made(result.estimate), options))

    def _pixel_mask_stage(self, result: Result, options: FrameOptions) -> Result:
        patch = self._with_pixels(_made(result.estimate), _made(result.patch))
        return replace(result, patch=patch)

    def _pose_stage(self, result: Result, options: FrameOptions) -> Result:
        tracker = _made(self.tracker)
        pose = tracker.update(result.frame, _made(result.estimate), _made(result.patch))
        return replace(result, pose=pose)

    @cached_property
    def _object_patch_finder(self) -> ObjectPatchFinder:
        from bubbleviz.pose import ObjectPatchFinder  # as the tracker

        return ObjectPatchFinder(self.model, _made(self.tracker).model)

    def _object_patch_stage(self, result: Result, options: FrameOptions) -> Result:
        pose, gas_pa = _made(result.pose), result.frame.gas_pressure_pa
        finder = self._object_patch_finder
        found = finder.find(_made(result.estimate), _made(result.patch), pose, gas_pa)
        return replace(result, object_patch=found)

    def _flow_stage(self, result: Result, options: FrameOptions) -> Result:
        return replace(result, flow=None if self.flow_of is None else self.flow_of(result.frame))

    def _traction_stage(self, result: Result, options: FrameOptions) -> Result:
        frame = result.frame
        traction, self._traction_start = self.traction_estimator.estimate(
            result.flow,
            frame.gas_pressure_pa,
            _made(result.estimate),
            self._start,
            self._traction_start,
        )
        return replace(result, traction=traction)

    def _slip_stage(self, result: Result, options: FrameOptions) -> Result:
        slip, self._slip_start = self._slip_finder.find(
            _made(result.traction), result.flow, self._slip_start
        )
        return replace(result, slip=slip)

    def _cloud_stage(self, result: Result, options: FrameOptions) -> Result:
        """Points of the pixels with a return, evenly fewer where there are too many."""
        depth_m, most = result.frame.depth_m, options.cloud_points
        returned = np.isfinite(depth_m)
        if most is not None and np.count_nonzero(returned) > most:
            pixels = _evenly(returned, most)
        else:
            pixels = np.flatnonzero(returned)
        return replace(result, cloud_m=self.camera.points(depth_m, pixels), cloud_pixels=pixels)

    def _residual_stage(self, result: Result, options: FrameOptions) -> Result:
        """Measured minus modelled range of the cloud's pixels, m."""
        pixels = _made(result.cloud_pixels)
        modelled = self.model.view.ranges(_made(result.estimate).motion_m, pixels)
        measured = self.model.ranges(result.frame.depth_m, pixels)
        return replace(result, cloud_residual_m=measured - modelled)

    def _texture_stage(self, result: Result, options: FrameOptions) -> Result:
        estimate = _made(result.estimate)
        if not estimate.trusted:
            return result
        nodes = self.mesh.deformed(estimate.motion_m)
        texture = Texture.of(SeenColour.of(result.frame), nodes, self.camera)
        return replace(result, texture=texture)

    def _with_pixels(self, estimate: Estimate, patch: Patch) -> Patch:
        return replace(patch, pixel_mask=self.model.view.patch_pixels(estimate, patch))

    @contextmanager
    def _timed(self, stage: str, times: dict[str, float]) -> Iterator[None]:
        start = time.perf_counter()
        yield
        times[stage] = 1e3 * (time.perf_counter() - start)
        self.counts[stage] += 1

    def _check_size(self, frame: Frame) -> None:
        height, width = frame.depth_m.shape
        own = self.camera.intrinsics
        if (height, width) != (own.height, own.width):
            raise InputError(
                f"frame {frame.index}: image is {width}×{height} pixels but the sensor's camera "
                f"has {own.width}×{own.height}; choose the sensor file of this camera"
            )


@dataclass(frozen=True)
class _Stage:
    """What makes one product, from products that were made before."""

    requires: tuple[Product, ...]
    run: Callable[[Pipeline, Result, FrameOptions], Result]


_STAGES: dict[Product, _Stage] = {
    "estimate": _Stage((), Pipeline._estimate_stage),
    "fine_contact": _Stage(("estimate",), Pipeline._fine_contact_stage),
    "patch": _Stage(("fine_contact",), Pipeline._patch_stage),
    "pixel_mask": _Stage(("patch",), Pipeline._pixel_mask_stage),
    "pose": _Stage(("patch",), Pipeline._pose_stage),
    "object_patch": _Stage(("pose",), Pipeline._object_patch_stage),
    "flow": _Stage((), Pipeline._flow_stage),
    "traction": _Stage(("estimate", "flow"), Pipeline._traction_stage),
    "slip": _Stage(("traction", "flow"), Pipeline._slip_stage),
    "cloud": _Stage((), Pipeline._cloud_stage),
    "residual": _Stage(("estimate", "cloud"), Pipeline._residual_stage),
    "texture": _Stage(("estimate",), Pipeline._texture_stage),
}
"""The stage of each product, in the order in which they run."""


def stages(products: frozenset[Product]) -> frozenset[Product]:
    """The products that are made on the way to these, and these."""
    needs = (LOOKS[name] if name in LOOKS else _STAGES[name].requires for name in products)
    return products.union(*(stages(frozenset(some)) for some in needs))


def _evenly(chosen: np.ndarray, most: int) -> np.ndarray:
    """At most so many of some pixels (H, W) bool, ascending flat indices, on a lattice.

    Every n-th of them in reading order would be in stripes.
    """
    height, width = chosen.shape
    step = -(-np.count_nonzero(chosen) // most)
    rows = np.arange(height)[:, None]
    columns = -round(_GOLDEN * step) * rows % step + step * np.arange(-(-width // step))
    pixels = (rows * width + columns)[columns < width]
    return pixels[chosen.ravel()[pixels]][:most]


def _made(product: _T | None) -> _T:
    if product is None:
        raise AssertionError("stages run in the order of the table")
    return product
