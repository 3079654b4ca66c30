"""Estimator of one sensor: depth image in, contact and force out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from threadpoolctl import ThreadpoolController

from bubbleviz.api.frame_warnings import FrameWarnings
from bubbleviz.api.frames import Frames
from bubbleviz.api.results import FrameResult, OneBlasThread
from bubbleviz.camera import ColourCamera, ColourImage, EncodedImage, Intrinsics
from bubbleviz.errors import InputError, check_given
from bubbleviz.files import checked_pose, parse_pose
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.pipeline import SHEAR, FrameOptions, Pipeline, Product
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import AUTO, Frame, check_unit, metres
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor, load_sensor, with_colour_delay
from bubbleviz.zeros import ImageZero, PressureZero, Zeros

if TYPE_CHECKING:
    from bubbleviz.shear import PassingTexture

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pose"})
"""The pose is only computed with an object to track, pixels of the patch on first use."""


class Estimator:
    """Contact, patch and force of one sensor, image by image, for your own loop.

    Solvers are built in advance. Every image is warm-started from the solution of the previous one,
    as in `estimate`.

    Parameters
    ----------
    sensor : str, path or Sensor
        Sensor file or preset.
    intrinsics : Intrinsics, optional
        Of the depth camera, instead of the sensor file's. If the first `Frame` has other
        intrinsics, the solvers are built again with those.
    object : str, path or RigidObject, optional
        Mesh file or preset of an object to track; results have its pose `T_B_O`.
    init : str or (4, 4) array, optional
        Its T_B_O in the first image, or "x y z qx qy qz qw"; by default it is searched.
    unit : {"m", "mm"}, optional
        As in `track`.
    kappa, solver, friction, colour_delay_s
        As in `estimate`.
    zero_gas : bool
        Shift the measured gas pressure so that it equals the sensor file's without contact, after
        the first 15 consecutive contact-free images; until then assume an error of ±2 kPa due to
        weather, or ±10 kPa if the file has the standard atmosphere. False: no shift.
    shear : bool
        Estimate force, with friction at every node, and slip from depth and colour together, once
        there are 20 colour images without contact.

    Raises
    ------
    InputError
        There is no such sensor, object or solver, or they do not match.

    Examples
    --------
    >>> estimator = bv.Estimator("punyo_oval_d405")
    >>> found = estimator.update(depth_m, gas_pressure_pa=106_600.0)
    >>> found.status, found.force_n
    """

    def __init__(
        self,
        sensor: str | Path | Sensor,
        *,
        intrinsics: Intrinsics | None = None,
        object: str | Path | RigidObject | None = None,
        init: str | np.ndarray | None = None,
        unit: Literal["m", "mm"] | None = None,
        kappa: float | None = None,
        solver: str | None = None,
        friction: float | None = None,
        zero_gas: bool = True,
        shear: bool = False,
        colour_delay_s: float | None = None,
    ) -> None:
        if str(sensor) == AUTO:
            raise InputError(
                f"sensor {AUTO}: needs a recording to choose the sensor by; give Estimator a "
                "sensor file or preset"
            )
        if init is not None and object is None:
            raise InputError("init: the pose of an object, which is not given; give object, too")
        initial_pose = given_pose(init)
        self._tracked = None if object is None else (load_object(object, unit), initial_pose)
        self._sensor = with_colour_delay(load_sensor(sensor), colour_delay_s)
        self._estimator_options = EstimatorOptions.named(solver, friction)
        self._options = patch_options(kappa)
        self._zero_gas, self._shear = zero_gas, shear
        self._build(intrinsics)

    def _build(self, intrinsics: Intrinsics | None) -> None:
        with OneBlasThread():
            self._pipeline = Pipeline.of(self._sensor, intrinsics, self._estimator_options)
            self.reset()

    def reset(self) -> None:
        """Discard warm start, zeros of gas pressure and depth image, pose and colour reference."""
        pipeline, texture = self._pipeline, None
        pipeline.restart()
        if self._tracked is not None:
            pipeline.track(*self._tracked)
        if self._shear:
            from bubbleviz.shear import PassingTexture  # needs OpenCV

            refuse_frictionless_shear(pipeline)
            texture = PassingTexture(pipeline)
        gas = PressureZero(pipeline.model.sensor.pneumatics) if self._zero_gas else None
        products = PRODUCTS if texture is None else PRODUCTS | SHEAR
        self.solver = FrameSolver(
            pipeline, products, self._options, Zeros.of_stream(gas, pipeline), texture
        )
        self._count, self._first_stamp_ns, self._unit_known = 0, 0, False

    def update(
        self,
        depth: np.ndarray | Frame,
        gas_pressure_pa: float | None = None,
        colour: np.ndarray | None = None,
        time_s: float | None = None,
    ) -> FrameResult:
        """Estimate the next image.

        Parameters
        ----------
        depth : (H, W) array or Frame
            z-depth: floats in m, integers in mm, as in a `16UC1` image; convert other units to
            metres, `raw * scale`. 0 and NaN mean no return. A `Frame` includes the other arguments.
        gas_pressure_pa : float, optional
            Absolute pressure of the gas, Pa; by default from the gas law.
        colour : (H, W, 3) uint8 array, optional
            Red, green and blue of the same pixels, for `shear`.
        time_s : float, optional
            Time of the image, s; by default the present. If it is the time since 1970, `age_s` of
            the result counts from it, else from now.

        Returns
        -------
        FrameResult

        Raises
        ------
        InputError
            Wrong shape, type or unit.
        """
        if isinstance(depth, Frame):
            if any(each is not None for each in (gas_pressure_pa, colour, time_s)):
                raise InputError(
                    "a Frame already contains gas pressure, colour and time; leave those "
                    "arguments out"
                )
            frame, intrinsics = depth, depth.intrinsics
            if not self._count and intrinsics not in (None, self._pipeline.camera.intrinsics):
                self._build(intrinsics)
        else:
            frame = self._frame(depth, gas_pressure_pa, colour, time_s)
        found = FrameResult(self.solver.solve(frame), self._pipeline.model)
        self._unit_known = self._unit_known or found.estimate.trusted
        if not self._unit_known:
            model = self._pipeline.model
            rest_m = model.view.rest_range / model.camera.range_per_depth
            remedy = "give floats in m or integers in mm"
            check_unit("depth", frame.depth_m, rest_m, remedy)
        self._count += 1
        return found

    def _frame(
        self,
        depth: np.ndarray,
        gas_pressure_pa: float | None,
        colour: np.ndarray | None,
        time_s: float | None,
    ) -> Frame:
        own, raw = self._pipeline.camera.intrinsics, np.asarray(depth)
        shape = own.height, own.width
        if raw.shape != shape or raw.dtype.kind not in "fiu":
            raise InputError(
                f"depth: expected an array {shape} of floats in m or integers in mm, as the camera "
                f"of sensor {self._sensor.name} has; this is {raw.dtype} {raw.shape}"
            )
        for name, value in (("gas_pressure_pa", gas_pressure_pa), ("time_s", time_s)):
            if value is not None and not (isinstance(value, Real) and math.isfinite(value)):
                raise InputError(f"{name}: expected a finite number or None, got {value!r}")
        known_pa = self._pipeline.model.gas.P0
        if gas_pressure_pa is not None and not 0.5 < gas_pressure_pa / known_pa < 2.0:
            raise InputError(
                f"gas_pressure_pa = {gas_pressure_pa:g}: expected the absolute pressure in Pa, "
                f"near {known_pa:.0f} for sensor {self._sensor.name}, or None if not measured"
            )
        now_ns = time.time_ns()
        stamp_ns = now_ns if time_s is None else round(1e9 * time_s)
        if not self._count:
            self._first_stamp_ns = stamp_ns
        return Frame(
            index=self._count,
            time_s=1e-9 * (stamp_ns - self._first_stamp_ns),
            depth_m=metres(raw.astype(np.float32), 1.0 if raw.dtype.kind == "f" else 1e-3),
            intrinsics=own,
            gas_pressure_pa=gas_pressure_pa,
            stamp_ns=stamp_ns,
            arrival_ns=now_ns,
            find_colour=None if colour is None else self._colour(np.asarray(colour), shape),
        )

    def _colour(
        self, rgb: np.ndarray, shape: tuple[int, int]
    ) -> Callable[[float], ColourImage | None]:
        if rgb.shape != (*shape, 3) or rgb.dtype != np.uint8:
            raise InputError(
                f"colour: expected an array {(*shape, 3)} of uint8, red, green and blue of the "
                f"pixels of the depth image; this is {rgb.dtype} {rgb.shape}"
            )
        height, width = shape
        encoded = EncodedImage("rgb8", rgb.tobytes(), width, height, 3 * width)
        camera = ColourCamera(self._pipeline.camera.intrinsics)
        image = ColourImage(lambda: encoded, camera=camera)
        return lambda _: image


def refuse_frictionless_shear(pipeline: Pipeline) -> None:
    """Raise InputError if colour images, which show friction, are asked for without friction."""
    if not pipeline.options.friction:
        raise InputError(
            "--shear measures friction by colour images, which --friction 0 excludes; leave out "
            "one of them"
        )


class FrameSolver:
    """Solves frames one after the other, for `Estimator`, recordings and streams.

    `zeros` correct gas pressure and depth image; `texture` adds optical flow.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        products: frozenset[Product] = PRODUCTS,
        options: FrameOptions | None = None,
        zeros: Zeros | None = None,
        texture: PassingTexture | None = None,
    ) -> None:
        pipeline.prepare(products)  # set-up is not part of the first frame's time
        self.pipeline, self.texture = pipeline, texture
        self.zeros = zeros or Zeros(None, ImageZero())
        self._products, self._options = products, options
        self._warnings, self._count = FrameWarnings(pipeline, self.zeros), 0
        self._blas = ThreadpoolController()  # finding the libraries takes 2 ms, so only once

    def solve(self, frame: Frame) -> Result:
        """The products of the next frame."""
        with self._blas.limit(limits=1, user_api="blas"):  # as `OneBlasThread`
            zeroed = self.zeros.zeroed(frame, self.pipeline)
            result = self.pipeline.process(zeroed, self._products, self._options)
            self.zeros.follow(frame, result, self.pipeline)
            if self.texture is not None:
                self.texture.take(result)
        self._warnings.take(self._count, frame, result)
        self._count += 1
        return result

    def warnings(self) -> list[str]:
        """Warnings about the frames so far."""
        return list(self._warnings.texts().values())


def given_pose(init: str | np.ndarray | None) -> np.ndarray | None:
    """T_B_O (4, 4) of an option `init`. Raises InputError: it is not a rigid transform."""
    if init is None:
        return None
    return parse_pose(init) if isinstance(init, str) else checked_pose(init)


def patch_options(kappa: float | None) -> FrameOptions:
    """Options with a patch threshold. Raises InputError: it is not a number ≥ 0."""
    check_given("--kappa", kappa, 0.0)
    return FrameOptions(kappa, fine_contact=kappa is None)


def solved(frames: Frames, solver: FrameSolver, progress: Progress = quiet) -> Iterator[Result]:
    """Results of frames in order, warm-started. Raises InputError: a frame cannot be read."""
    for done, index in enumerate(frames.chosen, 1):
        yield solver.solve(frames.source[index])
        progress("solving", done / len(frames))
