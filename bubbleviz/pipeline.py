"""The pipeline: runs the stages that the requested products need."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from bubbleviz.camera import DepthCamera, FlowField, FlowObserver, Intrinsics, MeasuredFlow
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
    Start,
    mesh_limits,
    without_small,
)
from bubbleviz.membrane import constant_tension_deviation, rubber_and_variants
from bubbleviz.plugins import plugin, plugin_names
from bubbleviz.recordings import Frame, FrameColour, Texture
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor, size_refusal
from bubbleviz.sensor_model import SensorModel

if TYPE_CHECKING:
    from bubbleviz.pose import ObjectPatchFinder, PoseTracker
    from bubbleviz.shear import SlipFinder, SlipStart

_T = TypeVar("_T")
_GOLDEN = 0.5 * (3.0 - 5.0**0.5)
"""Shift of a lattice from row to row over its period, from the golden ratio to avoid stripes."""

Product = Literal[
    "estimate", "fine_contact", "patch", "pixel_mask", "cloud", "residual", "pose", "object_patch",
    "flow", "traction", "slip", "texture",
    "depth_image", "change_image", "residual_image", "noise_image", "used_image", "colour_image",
    "flow_image", "kappa_curve", "components",
]  # fmt: skip

DIAGNOSTICS: dict[Product, tuple[Product, ...]] = {
    **dict.fromkeys(("depth_image", "change_image", "noise_image", "used_image"), ()),
    "residual_image": ("estimate",),
    "colour_image": (),
    "flow_image": ("estimate", "flow"),
    "kappa_curve": ("estimate",),
    "components": ("estimate", "patch"),
}
"""Diagnostics for panels, and the products that each depends on."""

SHEAR: frozenset[Product] = frozenset({"traction", "slip"})
"""Products of depth and optical flow together."""
FLOW_PRODUCTS: frozenset[Product] = SHEAR | {"flow"}
"""Products with which the estimate uses optical flow."""
OBJECT_PRODUCTS: frozenset[Product] = frozenset({"pose", "object_patch"})
"""Products that require a tracked object."""
COLOUR_PRODUCTS: frozenset[Product] = frozenset(FLOW_PRODUCTS | {"texture", "colour_image"})
"""Products that require the colour image."""

FlowFunction = Callable[[Frame], "FlowField | None"]
"""Optical flow from the contact-free colour image to the image of a frame; None: unavailable."""


@dataclass(frozen=True)
class FrameOptions:
    """Options that may change from frame to frame; estimator options may not."""

    # patch threshold as a multiple of the mean contact pressure (V-C); None: the physical threshold
    # of `PatchFinder`
    kappa: float | None = None
    least_area_m2: float = 0.0  # smaller parts of the patch are removed
    # largest number of cloud points, evenly spread over the image; None: all
    cloud_points: int | None = None
    # refine the contact for the patch where the mesh limits it. The κ rule does not use the
    # refinement, but the window can then change rules without solving again.
    fine_contact: bool = True


class Pipeline:
    """Computes requested products of frames; each solve is warm-started from the previous frame."""

    def __init__(self, model: SensorModel, options: EstimatorOptions | None = None) -> None:
        # mesh: reference surface
        self.model, self.mesh, self.camera = model, model.mesh, model.camera
        self.options = options or EstimatorOptions()
        self.counts: Counter[str] = Counter()  # number of runs of each stage, by name
        self.tracker: PoseTracker | None = None  # see `track`
        self._state: Any = None  # for the warm start; the type depends on the estimator
        self.optical_flow: FlowFunction | None = None  # see `use_optical_flow`
        self._colour_camera = self.camera
        # before and after the last frame
        self._slip_starts: tuple[SlipStart | None, SlipStart | None] = (None, None)

    @classmethod
    def of(
        cls,
        sensor: Sensor,
        intrinsics: Intrinsics | None = None,
        options: EstimatorOptions | None = None,
    ) -> Pipeline:
        """Pipeline of a sensor file; parameters and errors as in `SensorModel.of`."""
        nodes = None if options is None else options.nodes
        return cls(SensorModel.of(sensor, intrinsics, nodes), options)

    @cached_property
    def estimator(self) -> Estimator:
        """The inverse solver, built on first use."""
        model = self.model
        observer = model.observer(self.options.block)
        has_prestretch = model.sensor.membrane.prestretch is not None
        if self.options.solver == RUBBER or (self.options.solver is None and has_prestretch):
            material = model.sensor, model.mesh, model.tension_n_per_m, self.options.rim_slack_m
            rubber, varied = rubber_and_variants(*material)
            return Estimator(observer, RubberBubble(rubber, model.gas, varied), self.options)
        unsure = constant_tension_deviation(model.sensor, model.tension_n_per_m)
        film = ConstantTension(model.mesh, model.tension_n_per_m, model.gas, unsure)
        if self.options.solver == PAPER:
            from bubbleviz.inverse import PaperEstimator  # only needed here

            return PaperEstimator(observer, film, self.options)
        if self.options.solver in (None, LINEAR):
            return Estimator(observer, film, self.options)
        if (plugged := plugin("solvers", self.options.solver)) is not None:
            estimator: Estimator = plugged(model, self.options)
            return estimator
        names = ", ".join([*SOLVER_NAMES, *plugin_names("solvers")])
        raise InputError(f"--solver {self.options.solver}: no such solver; choose one of {names}")

    def process(
        self,
        frame: Frame,
        products: frozenset[Product],
        options: FrameOptions | None = None,
        estimate: Estimate | None = None,  # of this frame, where it is known
    ) -> Result:
        """Run the stages that `products` depend on, on one frame.

        Raises InputError: the image does not have the camera's size.
        """
        self._check_size(frame)
        options, needed = options or FrameOptions(), stages(products)
        times: dict[str, float] = {}
        result = Result(self.paired(frame), estimate=estimate)

        with self._timed("total", times):
            for name in _STAGES:
                if name in needed and self._is_available(name, options, frame):
                    with self._timed(name, times):
                        result = _STAGES[name].run(self, result, options)
        return self.diagnose(replace(result, times_ms=times), products, options)

    def extended(
        self, result: Result, product: Product, run: Callable[[Result], Result] | None = None
    ) -> Result:
        """A result with another product, by its stage or a given function, and with its time."""
        times: dict[str, float] = {}
        with self._timed(product, times):
            stage = _STAGES[product].run
            found = run(result) if run is not None else stage(self, result, FrameOptions())
        for name in (product, "total"):
            times[name] = times[product] + result.times_ms.get(name, 0.0)
        return replace(found, times_ms=result.times_ms | times)

    def diagnose(
        self,
        result: Result,
        products: frozenset[Product],
        options: FrameOptions | None = None,  # of its patch
        truth: np.ndarray | None = None,  # (H, W) bool, true pixels of a simulated patch
    ) -> Result:
        """The result with the diagnostics among the products."""
        requested = products & DIAGNOSTICS.keys()
        if not requested:
            return result
        from bubbleviz.diagnostics import inspection  # only for panels

        self.counts.update(f"diagnose {name.removesuffix('_image')}" for name in requested)
        kappa = None if options is None else options.kappa
        return replace(result, inspection=inspection(self, result, requested, kappa, truth))

    def _is_available(self, name: Product, options: FrameOptions, frame: Frame) -> bool:
        if name == "fine_contact":
            refines = options.fine_contact and self._refiner is not None
            return refines and mesh_limits(self.estimator, frame.noise * frame.mean_noise)
        return name not in OBJECT_PRODUCTS or self.tracker is not None

    def paired(self, frame: Frame) -> Frame:
        """Frame paired with the colour image at the sensor's colour delay."""
        delay_s = self.model.sensor.camera.colour_delay_s
        return frame if frame.colour_delay_s == delay_s else replace(frame, colour_delay_s=delay_s)

    def restart(self, start: Start | None = None) -> None:
        """Solve the next frame from the `start` of another one; by default from rest.

        From rest, the result does not depend on earlier frames.
        """
        self._state = start

    @property
    def start(self) -> Start | None:
        """Warm start by the contact of the last frame by depth alone, without its factorisation.

        None without contact, and with estimators of other packages.
        """
        start = self._state
        if not isinstance(start, Start) or start.state is None:
            return None
        return replace(start, tangent=None, view=None, by_flow=None)

    def is_untouched(self, frame: Frame) -> bool:
        """Whether the depth image alone, without the gas pressure, shows no contact.

        Raises InputError: the image does not have the camera's size.
        """
        self._check_size(frame)
        known = {} if frame.noise == 1.0 else {"noise": frame.noise}  # as in `_estimated`
        return self.estimator.is_untouched(frame.depth_m, **known)

    def image_noise(self, frames: Sequence[Frame]) -> tuple[float, float]:
        """Noise factor of consecutive frames without contact, and inflation of their mean."""
        return self.estimator.image_noise([frame.depth_m for frame in frames])

    def estimate_once(self, frame: Frame) -> Estimate:
        """Estimate of a frame that leaves the warm start of the next one unchanged.

        Raises InputError: the image does not have the camera's size.
        """
        self._check_size(frame)
        return self._estimated(frame, self._state)[0]

    def _estimated(
        self, frame: Frame, state: Any, flow: MeasuredFlow | None = None
    ) -> tuple[Estimate, Any]:
        measured = frame.steady_depth_m, frame.gas_pressure_pa, state, frame.gas_sigma_pa
        known: dict[str, Any] = {}  # solvers of other packages may not know these
        if flow is not None:
            known["flow"] = flow
        if frame.image_errors is not None and self.estimator.solver_name in (RUBBER, LINEAR):
            known["image_errors"] = frame.image_errors
        if frame.noise > 1.0:
            known["noise"] = frame.noise
        return self.estimator.estimate(*measured, **known)

    def prepare(self, products: frozenset[Product]) -> None:
        """Build the solvers in advance, so that the first frame is not delayed."""
        needed = stages(products)
        if "estimate" in needed:
            _ = self.estimator
        if "patch" in needed:
            _ = self._finder, self.model.view
        if "residual" in needed:
            _ = self.model.view.at_rest
        if "traction" in needed:
            _ = self.flow_observer

    def track(
        self,
        obj: RigidObject | None,
        initial_pose: np.ndarray | None = None,
        *,
        thorough: bool = False,
    ) -> None:
        """Track an object from the next frame on, or none.

        Parameters
        ----------
        obj : RigidObject or None
        initial_pose : (4, 4) array, optional
            T_B_O in the next frame; None: searched.
        thorough : bool
            Each frame compares all poses that are possible, not only a few, and may take seconds.

        Raises
        ------
        InputError
            The object has no area, or its size does not match the bubble (wrong units).
        """
        self.__dict__.pop("_object_patch_finder", None)
        if obj is None:
            self.tracker = None
            return
        from bubbleviz.pose import PoseTracker  # only needed here

        self.tracker = PoseTracker(
            self.estimator, obj, initial_pose, membrane=self.model.rubber, thorough=thorough
        )

    @property
    def object(self) -> RigidObject | None:
        """The object that is tracked."""
        return None if self.tracker is None else self.tracker.model.obj

    def use_optical_flow(
        self,
        optical_flow: FlowFunction | None,  # None: without colour, traction from depth alone
        # colour camera; None: the depth camera, as for images aligned to depth
        camera: DepthCamera | None = None,
    ) -> None:
        """Use optical flow, where it is requested, from the next frame on."""
        self.optical_flow, self._colour_camera = optical_flow, camera or self.camera
        self._slip_starts = (None, None)
        for name in ("flow_observer", "_slip_finder"):
            self.__dict__.pop(name, None)

    @cached_property
    def flow_observer(self) -> FlowObserver:
        """Model of the optical flow, built on first use.

        Raises InputError: the solver is not that of the exact membrane, or the colour camera does
        not see it.
        """
        _ = self._exact_bubble
        return FlowObserver(self._colour_camera, self.mesh)

    @property
    def _exact_bubble(self) -> RubberBubble:
        """Raises InputError: the solver does not use the exact membrane."""
        bubble = self.estimator.bubble
        if self.estimator.solver_name != RUBBER:
            default = f" (the default, as sensor {self.model.sensor.name} has no prestretch)"
            raise InputError(
                f"solver {self.options.solver or self.estimator.solver_name + default}: "
                "cannot estimate shear; choose solver rubber (--solver)"
            )
        assert isinstance(bubble, RubberBubble)
        return bubble

    @cached_property
    def _slip_finder(self) -> SlipFinder:
        from bubbleviz.shear import SlipFinder  # only needed here

        held, resolution = self.estimator.held_pressure_pa, self.estimator.resolution_m
        return SlipFinder(self.flow_observer, self.mesh, held, resolution)

    def patch(
        self, estimate: Estimate, options: FrameOptions | None = None, *, pixel_mask: bool = False
    ) -> Patch:
        """Patch of an estimate, without solving again."""
        options = options or FrameOptions()
        patch = self.unfiltered_patch(estimate, options.kappa)
        if options.least_area_m2 > 0.0:
            patch = without_small(self.mesh, estimate, patch, options.least_area_m2)
        return self._with_pixels(estimate, patch) if pixel_mask else patch

    def unfiltered_patch(self, estimate: Estimate, kappa: float | None = None) -> Patch:
        """Patch of an estimate with all parts, however small."""
        return self._finder.find(estimate, kappa)

    @cached_property
    def _finder(self) -> PatchFinder:
        return PatchFinder(self.mesh, self.estimator.held_pressure_pa, self.estimator.resolution_m)

    @cached_property
    def _refiner(self) -> ContactRefiner | None:
        """None where the solver or the options exclude it."""
        possible = self.options.fine_contact and self.estimator.solver_name in (RUBBER, LINEAR)
        return ContactRefiner(self.model, self.estimator) if possible else None

    def _estimate_stage(self, result: Result, options: FrameOptions) -> Result:
        frame, estimate = result.frame, result.estimate
        if estimate is None:
            flow = self._measured_flow(result)
            estimate, self._state = self._estimated(frame, self._state, flow)
        if frame.gas_sigma_pa and estimate.trusted:  # later stages use the estimated gas pressure
            estimated = self.model.gas.P0 + estimate.gas_pressure_change_pa
            frame = replace(frame, gas_pressure_pa=estimated, gas_sigma_pa=0.0)
        return replace(result, estimate=estimate, frame=frame)

    def _measured_flow(self, result: Result) -> MeasuredFlow | None:
        """The frame's optical flow for the estimator; None where there is none, or no friction."""
        flow = result.flow
        frictionless = self.estimator.solver_name != RUBBER or not self.options.friction
        if flow is None or not len(flow.pixel) or frictionless:
            return None
        return self.flow_observer.measure(flow)

    def _fine_contact_stage(self, result: Result, options: FrameOptions) -> Result:
        estimate, frame = _required(result.estimate), result.frame
        if estimate.fine is not None:
            return result
        refiner = _required(self._refiner)
        fine = refiner.refine(frame.steady_depth_m, estimate, frame.noise * frame.mean_noise)
        return result if fine is None else replace(result, estimate=replace(estimate, fine=fine))

    def _patch_stage(self, result: Result, options: FrameOptions) -> Result:
        return replace(result, patch=self.patch(_required(result.estimate), options))

    def _pixel_mask_stage(self, result: Result, options: FrameOptions) -> Result:
        patch = self._with_pixels(_required(result.estimate), _required(result.patch))
        return replace(result, patch=patch)

    def _pose_stage(self, result: Result, options: FrameOptions) -> Result:
        tracker = _required(self.tracker)
        pose = tracker.update(result.frame, _required(result.estimate), _required(result.patch))
        return replace(result, pose=pose)

    @cached_property
    def _object_patch_finder(self) -> ObjectPatchFinder:
        from bubbleviz.pose import ObjectPatchFinder  # open3d takes long to load

        return ObjectPatchFinder(self.model, _required(self.tracker).model)

    def _object_patch_stage(self, result: Result, options: FrameOptions) -> Result:
        pose, gas_pa = _required(result.pose), result.frame.gas_pressure_pa
        finder = self._object_patch_finder
        found = finder.find(_required(result.estimate), _required(result.patch), pose, gas_pa)
        return replace(result, object_patch=found)

    def _flow_stage(self, result: Result, options: FrameOptions) -> Result:
        flow = None if self.optical_flow is None else self.optical_flow(result.frame)
        return replace(result, flow=flow)

    def _traction_stage(self, result: Result, options: FrameOptions) -> Result:
        from bubbleviz.shear import traction_of  # only needed here

        bubble, friction = self._exact_bubble, self.options.friction
        return replace(result, traction=traction_of(bubble, result, friction))

    def _slip_stage(self, result: Result, options: FrameOptions) -> Result:
        frame, (before, after) = result.frame, self._slip_starts
        again = after is not None and after.frame == frame.index  # compared with the same anchors
        start = before if again else after
        estimate = _required(result.estimate)
        slip, after = self._slip_finder.find(estimate, result.flow, frame, start)
        self._slip_starts = start, after
        return replace(result, slip=slip)

    def _cloud_stage(self, result: Result, options: FrameOptions) -> Result:
        """Points of the pixels with a return, evenly thinned to the largest number."""
        depth_m, most = result.frame.depth_m, options.cloud_points
        returned = np.isfinite(depth_m)
        if most is not None and np.count_nonzero(returned) > most:
            pixels = _evenly(returned, most)
        else:
            pixels = np.flatnonzero(returned)
        points_m = self.camera.displaced(result.estimate).points(depth_m, pixels)
        return replace(result, cloud_m=points_m, cloud_pixels=pixels)

    def _residual_stage(self, result: Result, options: FrameOptions) -> Result:
        """Measured minus modelled range of the cloud's pixels, m."""
        estimate, pixels = _required(result.estimate), _required(result.cloud_pixels)
        residual_m = self.model.residuals(result.frame.depth_m, estimate, pixels)
        return replace(result, cloud_residual_m=residual_m)

    def _texture_stage(self, result: Result, options: FrameOptions) -> Result:
        estimate = _required(result.estimate)
        if not estimate.trusted:
            return result
        nodes = self.mesh.deformed(estimate.motion_m)
        camera = self.camera.displaced(estimate)
        texture = Texture.of(FrameColour.of(result.frame), nodes, camera)
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
        size, own = frame.depth_m.shape[::-1], self.camera.intrinsics.size
        if size != own:
            raise size_refusal(f"frame {frame.index}: image is", size, self.model.sensor.name, own)


@dataclass(frozen=True)
class _Stage:
    """Function that computes a product, and the products that it requires."""

    requires: tuple[Product, ...]
    run: Callable[[Pipeline, Result, FrameOptions], Result]


_STAGES: dict[Product, _Stage] = {
    "flow": _Stage((), Pipeline._flow_stage),
    "estimate": _Stage((), Pipeline._estimate_stage),
    "fine_contact": _Stage(("estimate",), Pipeline._fine_contact_stage),
    "patch": _Stage(("fine_contact",), Pipeline._patch_stage),
    "pixel_mask": _Stage(("patch",), Pipeline._pixel_mask_stage),
    "pose": _Stage(("patch",), Pipeline._pose_stage),
    "object_patch": _Stage(("pose",), Pipeline._object_patch_stage),
    "traction": _Stage(("patch", "flow"), Pipeline._traction_stage),
    "slip": _Stage(("estimate", "flow"), Pipeline._slip_stage),
    "cloud": _Stage((), Pipeline._cloud_stage),
    "residual": _Stage(("estimate", "cloud"), Pipeline._residual_stage),
    "texture": _Stage(("estimate",), Pipeline._texture_stage),
}
"""The stage of each product, in the order in which they run."""


def stages(products: frozenset[Product]) -> frozenset[Product]:
    """The products and all products that they depend on."""
    needs = (
        DIAGNOSTICS[name] if name in DIAGNOSTICS else _STAGES[name].requires for name in products
    )
    return products.union(*(stages(frozenset(some)) for some in needs))


def _evenly(chosen: np.ndarray, limit: int) -> np.ndarray:
    """Ascending flat indices of a lattice of at most `limit` pixels of a mask (H, W).

    Every n-th pixel in reading order would form stripes.
    """
    height, width = chosen.shape
    step = -(-np.count_nonzero(chosen) // limit)
    rows = np.arange(height)[:, None]
    columns = -round(_GOLDEN * step) * rows % step + step * np.arange(-(-width // step))
    pixels = (rows * width + columns)[columns < width]
    return pixels[chosen.ravel()[pixels]][:limit]


def _required(product: _T | None) -> _T:
    if product is None:
        raise AssertionError("internal error: a stage ran before one that it requires")
    return product
