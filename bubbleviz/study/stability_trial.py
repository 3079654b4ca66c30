"""What a stability case does: make a sensor and frames, estimate, and check the answer."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w

from bubbleviz.frames.frame import Frame
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.inverse.solvers.inverse_solver import RUBBER
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.press_path import touching_height
from bubbleviz.simulation.presses import made
from bubbleviz.simulation.synthetic_source import Model, SyntheticSource
from bubbleviz.simulation.truth import Truth
from bubbleviz.study.certificates import Band, forward_faults, inverse_faults

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask"})
TYPICAL_RANGE_M = 0.15  # from camera to dome, m
ANSWERS = ("ok", "no_contact")
PICO_FLEXX = DepthNoise(relative=0.01)

Alter = Callable[[np.ndarray], np.ndarray]
Must = Literal["solve", "refuse", "either"]


class RefusedError(Exception):
    """The program declined to answer, by a status that says why."""


class FailedError(Exception):
    """A wrong answer was given as a right one."""


@dataclass(frozen=True)
class Case:
    """One case.

    It returns what was found in words. It raises `FailedError` for a wrong answer; `RefusedError`,
    InputError or SolveError where the program refuses.
    """

    name: str
    run: Callable[[], str]
    must: Must = "either"  # an ordinary problem may not be refused, nor nonsense be answered
    limit_s: float = 120.0  # longer is a hang
    quick: bool = False  # part of the quick form


@dataclass(frozen=True)
class Trial:
    """A press of the pico flexx sensor, with something made extreme.

    With the solver `rubber` the truth is the exact membrane's even without a pre-stretch.
    """

    sensor: dict[str, dict[str, Any]] = field(default_factory=dict)  # changes of the file
    object_name: str | Callable[[], RigidObject] = "two_legged_toy"
    depth_m: float = 0.012  # beyond first touch; negative for an object that hovers
    depths_m: tuple[float, ...] = ()  # of every frame, in place of that one
    frozen: bool = False  # the camera repeats its first image for ever, noise and all
    offset_m: tuple[float, float] = (0.0, 0.0)  # of the object from the axis
    noise: DepthNoise = PICO_FLEXX
    alter: Alter | None = None  # what happens to the depth image on its way
    repeats: int = 3  # frames of the press; the first is cold
    options: EstimatorOptions = field(default_factory=EstimatorOptions)
    gas_pressure_pa: float | str | None = None  # measured; "true": the simulation's
    known: bool = True  # the truth still applies to the altered image
    truth_nodes: int = 3_200
    make: type[Pipeline] = Pipeline

    def __call__(self) -> str:
        """Run; what was found in words, or an error (see `Case`)."""
        sensor = varied_sensor(self.sensor)
        source = self._source(sensor)
        raise_faults(forward_faults(source.contact(0), sensor.pneumatics.gauge_pressure_pa))
        pipeline, refusals = self.make.of(sensor, options=self.options), list[str]()
        for k in range(len(source)):
            index = 0 if self.frozen else k
            truth = source.truth(index)
            frame = replace(self._frame(source, truth, sensor, index), index=k)
            result = pipeline.process(frame, PRODUCTS)
            status = result.estimate.status if result.estimate else "no estimate"
            if status not in ANSWERS:
                refusals.append(f"status {status}")
                continue
            known, measured = truth if self.known else None, self.gas_pressure_pa is not None
            faults = inverse_faults(pipeline, result, known, self.band, measured)
            raise_faults([f"frame {k}: {fault}" for fault in faults])
        if refusals:
            raise RefusedError(refusals[0])
        return _found(result, known)

    @property
    def band(self) -> Band:
        """Band of the force for this noise."""
        noise = self.noise
        return Band(float(np.hypot(noise.relative * TYPICAL_RANGE_M, noise.absolute_m)))

    def _source(self, sensor: Sensor) -> SyntheticSource:
        make = self.object_name
        obj = made(make) if isinstance(make, str) else make()
        depths = self.depths_m or (self.depth_m,) * self.repeats
        poses = np.tile(np.eye(4), (len(depths), 1, 1))
        poses[:, :2, 3], poses[:, 2, 3] = self.offset_m, 1.0
        model: Model | None = "rubber" if self.options.solver == RUBBER else None
        source = SyntheticSource(
            sensor, obj, poses, self.noise, nodes=self.truth_nodes, model=model
        )
        source.poses[:, 2, 3] = touching_height(obj, poses[0], source.mesh) - np.array(depths)
        return source

    def _frame(self, source: SyntheticSource, truth: Truth, sensor: Sensor, index: int) -> Frame:
        frame = source[index]
        pressure = self.gas_pressure_pa
        if pressure == "true":
            P0 = sensor.pneumatics.reference_pressure_pa
            pressure = P0 + truth.gas_pressure_change_pa
        depth = frame.depth_m if self.alter is None else self.alter(frame.depth_m)
        measured = None if pressure is None else float(pressure)
        return replace(frame, depth_m=depth, gas_pressure_pa=measured)


def raise_faults(faults: list[str]) -> None:
    """Raise `FailedError` where there are any."""
    if faults:
        raise FailedError("; ".join(faults))


def _found(result: Result, truth: Truth | None) -> str:
    if result.estimate is None or result.patch is None:
        return ""
    words = f"{result.estimate.status}, {np.linalg.norm(result.patch.force_n):.4g} N"
    if truth is not None:
        words += f" of {np.linalg.norm(truth.force_n):.4g} N"
    return f"{words}, KKT {result.estimate.kkt_residual:.1e}"


def varied_sensor(changes: dict[str, dict[str, Any]], name: str = "pico_flexx_75mm") -> Sensor:
    """Preset with some keys changed (None removes one), read back from a TOML file.

    Raises InputError: the file breaks the schema.
    """
    data = copy.deepcopy(load_sensor(name).model_dump(mode="json", exclude_none=True))
    for section, values in changes.items():
        data.setdefault(section, {}).update(values)
        data[section] = {k: v for k, v in data[section].items() if v is not None}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "varied.toml"
        path.write_text(tomli_w.dumps(data), encoding="utf-8")
        return load_sensor(path)
