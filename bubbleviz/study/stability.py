"""Stability study: extreme cases must be solved within tolerance, or refused with a reason."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from trimesh.convex import convex_hull

from bubbleviz.errors import InputError, SolveError
from bubbleviz.files import write_ply
from bubbleviz.inverse import RUBBER, EstimatorOptions
from bubbleviz.membrane import MembraneMesh, mesh_cap, spherical_cap
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.result import TRUSTED, Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor, edited, load_sensor
from bubbleviz.simulation import (
    DepthNoise,
    Model,
    SyntheticSource,
    Truth,
    study_object,
    touching_height,
)
from bubbleviz.study import harness
from bubbleviz.study.accuracy import PRODUCTS
from bubbleviz.study.harness import Band, Report, Study, forward_faults, inverse_faults
from bubbleviz.wording import counted

# A stability case makes a sensor and frames, estimates, and checks the result.


TYPICAL_RANGE_M = 0.15  # from camera to dome
PICO_FLEXX = DepthNoise(relative=0.01)

Alter = Callable[[np.ndarray], np.ndarray]
Must = Literal["solve", "refuse", "either"]


class FailedError(Exception):
    """A wrong estimate has a trusted status."""


@dataclass(frozen=True)
class Case:
    """One case, whose `run` returns a description of the result.

    Raises `FailedError` for a wrong result; InputError or SolveError if the input is refused.
    """

    name: str
    run: Callable[[], str]
    must: Must = "either"  # ordinary input must be solved, nonsense refused
    limit_s: float = 120.0  # a longer run counts as a hang
    quick: bool = False  # part of the quick study


@dataclass(frozen=True)
class Trial:
    """A press of the pico flexx sensor with an extreme parameter.

    With the solver `rubber` the ground truth is the exact membrane even without a pre-stretch.
    """

    sensor: dict[str, Any] = field(default_factory=dict)  # changed values, as of `edited`
    object_name: str | Callable[[], RigidObject] = "two_legged_toy"
    depth_m: float = 0.012  # beyond first touch; negative for an object that hovers
    depths_m: tuple[float, ...] = ()  # of every frame, instead of `depth_m`
    frozen: bool = False  # the camera repeats its first image, including noise
    offset_m: tuple[float, float] = (0.0, 0.0)  # of the object from the axis
    noise: DepthNoise = PICO_FLEXX
    alter: Alter | None = None  # change of the depth image
    repeats: int = 3  # frames of the press; the first is cold
    options: EstimatorOptions = field(default_factory=EstimatorOptions)
    gas_pressure_pa: float | str | None = None  # measured; "true": the simulation's
    known: bool = True  # the ground truth applies to the altered image
    truth_nodes: int = 3_200
    make: type[Pipeline] = Pipeline

    def __call__(self) -> str:
        """Run; returns and raises as `Case`."""
        sensor = edited(load_sensor("pico_flexx_75mm"), self.sensor)
        source = self._source(sensor)
        raise_faults(forward_faults(source.contact(0), sensor.pneumatics.gauge_pressure_pa))
        pipeline, refusals = self.make.of(sensor, options=self.options), list[str]()
        for k in range(len(source)):
            index = 0 if self.frozen else k
            truth = source.truth(index)
            frame = replace(self._frame(source, truth, sensor, index), index=k)
            result = pipeline.process(frame, PRODUCTS)
            status = result.estimate.status if result.estimate else "no estimate"
            if status not in TRUSTED:
                refusals.append(f"status {status}")
                continue
            known, measured = truth if self.known else None, self.gas_pressure_pa is not None
            faults = inverse_faults(pipeline, result, known, self.band, measured)
            raise_faults([f"frame {k}: {fault}" for fault in faults])
        if refusals:
            raise SolveError(refusals[0])
        return _description(result, known)

    @property
    def band(self) -> Band:
        """Tolerance of the force for this noise."""
        noise = self.noise
        return Band(float(np.hypot(noise.relative * TYPICAL_RANGE_M, noise.absolute_m)))

    def _source(self, sensor: Sensor) -> SyntheticSource:
        make = self.object_name
        obj = study_object(make) if isinstance(make, str) else make()
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
            rest_pa = sensor.pneumatics.reference_pressure_pa
            pressure = rest_pa + truth.gas_pressure_change_pa
        depth = frame.depth_m if self.alter is None else self.alter(frame.depth_m)
        measured = None if pressure is None else float(pressure)
        return replace(frame, depth_m=depth, gas_pressure_pa=measured)


def raise_faults(faults: list[str]) -> None:
    """Raise `FailedError` if there are any."""
    if faults:
        raise FailedError("; ".join(faults))


def _description(result: Result, truth: Truth | None) -> str:
    if result.estimate is None or result.patch is None:
        return ""
    text = f"{result.estimate.status}, {np.linalg.norm(result.patch.force_n):.4g} N"
    if truth is not None:
        text += f" of {np.linalg.norm(truth.force_n):.4g} N"
    return f"{text}, KKT {result.estimate.kkt_residual:.1e}"


Verdict = Literal["passed", "refused", "failed"]


@dataclass(frozen=True)
class CaseResult:
    """Verdict on one case, with description or reason, and run time."""

    name: str
    verdict: Verdict
    detail: str
    ms: float


def attempt(case: Case) -> tuple[Verdict, str]:
    """Run a case in this process; only documented exceptions are caught."""
    verdict: Verdict = "passed"
    try:
        detail = case.run()
    except FailedError as error:
        return "failed", str(error)
    except (InputError, SolveError) as error:
        verdict, detail = "refused", str(error) or type(error).__name__
    if case.must == "solve" and verdict == "refused":
        return "failed", f"refused, but must be solved: {detail}"
    if case.must == "refuse" and verdict == "passed":
        return "failed", f"solved, but must be refused: {detail}"
    return verdict, detail


def attempt_named(name: str) -> list[CaseResult]:
    """Run the shipped case of that name (in a worker process)."""
    start = time.perf_counter()
    verdict, detail = attempt(next(c for c in all_cases() if c.name == name))
    return [CaseResult(name, verdict, detail, 1e3 * (time.perf_counter() - start))]


def stability_study(pattern: str = "", *, quick: bool = False) -> Study:
    """Shipped cases whose name contains a pattern, each with its time limit.

    Raises InputError: there is none.
    """
    chosen = [c for c in all_cases() if pattern in c.name and c.quick >= quick]
    if not chosen:
        raise InputError(
            f"--case {pattern}: no name of a {'quick ' if quick else ''}case contains this; give "
            "another text, or leave it out"
        )
    cases = [
        harness.Case(
            c.name, partial(attempt_named, c.name), c.limit_s, partial(CaseResult, c.name, "failed")
        )
        for c in chosen
    ]
    return Study("stability", CaseResult, cases, report_of)


def report_of(results: Sequence[CaseResult]) -> Report:
    """Counts and every case."""
    verdicts = [result.verdict for result in results]
    names: tuple[Verdict, ...] = ("passed", "refused", "failed")
    counts = {str(name): verdicts.count(name) for name in names}
    text = f"{len(results)} cases: {counted(counts)}"
    lines = [f"{r.verdict:8} {r.name:44} {r.ms:8.0f} ms  {r.detail}" for r in results]
    numbers = {"cases": len(results), **counts}
    return Report(numbers=numbers, text="\n".join([*lines, text]), rows_name="results")


# The cases of the stability study.


PSI = 6_894.757  # Pa (NIST SP 811)
CHAMBER = "pneumatics.chamber_volume_m3"
REST_PA = 101_325.0 + 2_585.5  # of the pico flexx sensor


def all_cases() -> list[Case]:
    """Every case, in the order in which the study runs them."""
    groups = (
        _tension, _gauge, _dome, _chamber, _meshes, _slivers, _contacts, _gas, _noise, _pixels,
        _nonsense, _streams, _formats, _bad_input, _solvers, _rubber, _rubber_views,
    )  # fmt: skip
    return [case for group in groups for case in group()]


def _tension() -> Iterator[Case]:
    for power in range(-3, 7):
        trial = Trial({"pneumatics.tension_n_per_m": 10.0**power})
        must: Must = "solve" if power in (1, 2, 3) else "either"
        yield Case(f"tension 1e{power} N/m", trial, must, quick=power in (-3, 6))


def _gauge() -> Iterator[Case]:
    for psi in (0.001, 0.01, 0.1, 1.0, 10.0):
        pressure = {"pneumatics.gauge_pressure_pa": psi * PSI}
        must: Must = "solve" if 0.1 <= psi <= 1.0 else "either"
        yield Case(f"gauge {psi:g} psi", Trial(pressure), must, quick=psi > 5.0)
        fixed_tension = {**pressure, "pneumatics.tension_n_per_m": 105.0}
        yield Case(f"gauge {psi:g} psi, tension 105 N/m", Trial(fixed_tension))


def _dome() -> Iterator[Case]:
    for share in (0.02, 0.05, 0.2, 0.5, 0.9, 1.0, 1.2, 1.5):
        height = share * 0.075
        trial = Trial({"membrane.height_m": height}, depth_m=min(0.012, 0.5 * height))
        yield Case(f"dome {100 * share:g} % of the rim radius", trial, quick=share in (0.02, 1.5))


def _chamber() -> Iterator[Case]:
    for power in range(-7, 2):
        trial = Trial({CHAMBER: 10.0**power})
        must: Must = "solve" if power in (-3, -2) else "either"
        yield Case(f"chamber 1e{power} m³", trial, must, quick=power in (-7, 1))
    for power in (-7, 1):
        paper = {CHAMBER: 10.0**power, "pneumatics.volume_model": "paper"}
        yield Case(f"chamber 1e{power} m³, volume model paper", Trial(paper))


def _meshes() -> Iterator[Case]:
    for nodes in (30, 100, 5_000, 10_000, 50_000):
        trial = Trial({"membrane.nodes": nodes})
        limit = 120.0 if nodes < 5_000 else 300.0
        yield Case(f"{nodes} nodes", trial, limit_s=limit, quick=nodes == 30)


def _slivers() -> Iterator[Case]:
    for degrees in (10.0, 5.0, 2.0, 1.0, 0.5):
        yield Case(f"slivers of {degrees:g}°", _mesh_trial(degrees), quick=degrees == 0.5)
    yield Case("mesh file without tension", _mesh_trial(None), "solve", quick=True)


def _mesh_trial(degrees: float | None) -> Callable[[], str]:
    """Press of a membrane from a mesh file: with slivers and γ0 = P R/2, or with neither."""

    def run() -> str:
        mesh, gas = mesh_cap(spherical_cap(0.075, 0.050), 800), {}
        if degrees is not None:
            mesh = with_slivers(mesh, np.deg2rad(degrees))
            gas = {"pneumatics.tension_n_per_m": 105.0}
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "slivers.ply"
            write_ply(path, mesh.nodes, {}, mesh.triangles)
            return Trial({"membrane.shape": "mesh", "membrane.mesh_file": str(path), **gas})()

    return run


def _contacts() -> Iterator[Case]:
    yield Case("needle on one node", Trial(object_name=needle, depth_m=0.010), quick=True)
    yield Case("blade", Trial(object_name=blade, depth_m=0.010))
    yield Case("plate over everything", Trial(object_name=plate, depth_m=0.015), quick=True)
    yield Case("plate, 40 mm of 50", Trial(object_name=plate, depth_m=0.040))
    inside = Trial(object_name=pellet, depth_m=0.035)
    yield Case("object wholly inside", inside, quick=True)
    yield Case("object wholly inside, off the axis", replace(inside, offset_m=(0.02, 0.0)))
    for depth in (1e-6, 1e-4, 1e-3):
        yield Case(f"grazing, {1e3 * depth:g} mm", Trial(depth_m=depth), quick=depth == 1e-4)
    deep = Trial(object_name="sphere", depth_m=0.045)
    yield Case("press to 90 % of the height", deep, quick=True)
    yield Case("press to 60 % of the height", replace(deep, depth_m=0.030))
    far = Trial(object_name=two_far_balls, depth_m=0.010)
    yield Case("two far contacts", far, "solve", quick=True)
    yield Case("hovering object", Trial(depth_m=-0.005), "solve", quick=True)
    yield Case("contact by the rim", Trial(object_name="sphere", offset_m=(0.055, 0.0)))
    yield Case("object on the rim", Trial(object_name="sphere", offset_m=(0.075, 0.0)), "either")
    yield Case("large ball", Trial(object_name=large_ball, depth_m=0.02), "solve")


def _gas() -> Iterator[Case]:
    yield Case("gas pressure measured, true", Trial(gas_pressure_pa="true"), "solve", quick=True)
    yield Case("gas pressure measured, 250 Pa above rest", Trial(gas_pressure_pa=REST_PA + 250.0))
    values = {
        "nan": np.nan, "inf": np.inf, "-inf": -np.inf, "0 Pa": 0.0, "-1e5 Pa": -1e5,
        "1e9 Pa": 1e9, "1 Pa": 1.0, "in kPa": 1e-3 * REST_PA, "doubled": 2.0 * REST_PA,
    }  # fmt: skip
    for name, value in values.items():
        quick = name in ("nan", "1e9 Pa")
        yield Case(f"gas pressure measured, {name}", Trial(gas_pressure_pa=value), quick=quick)


def _noise() -> Iterator[Case]:
    for mm in (0.0, 0.1, 1.0, 3.0, 10.0):
        noise = DepthNoise(absolute_m=1e-3 * mm)
        trial = Trial(noise=noise)
        must: Must = "solve" if mm <= 1.0 else "either"
        yield Case(f"noise {mm:g} mm, sensor file says 1 %", trial, must, quick=mm in (0.0, 10.0))
        declared = {"camera.noise_relative": max(1e-3 * mm / TYPICAL_RANGE_M, 1e-6)}
        trial = Trial(declared, noise=noise)
        yield Case(f"noise {mm:g} mm, declared", trial, must)
    correlated = DepthNoise(relative=0.01, correlation_px=8.0)
    yield Case("noise 1 %, correlated over 8 pixels", Trial(noise=correlated))
    quiet = Trial(noise=DepthNoise(absolute_m=1e-2), depth_m=-0.005)
    yield Case("noise 10 mm, no contact", quiet)


def _pixels() -> Iterator[Case]:
    for count in (0, 1, 2, 10):
        must: Must = "refuse" if count == 0 else "either"
        trial = Trial(alter=only_pixels(count))
        yield Case(f"{count} valid pixels", trial, must, quick=count < 3)
    yield Case("every tenth pixel", Trial(alter=every(10)))
    yield Case("left half of the image", Trial(alter=left_half))
    for share in (0.5, 0.9):
        # Holes come with correlated noise, which the sensor file does not describe: at the file's
        # σ the images may be refused, at a fifth of it they must be solved.
        loud, low = (
            DepthNoise(relative=sigma, holes=share, correlation_px=5.0) for sigma in (0.01, 0.002)
        )
        must = "solve" if share == 0.5 else "either"
        yield Case(f"{100 * share:g} % holes", Trial(noise=low), must)
        yield Case(f"{100 * share:g} % holes, 1 % correlated noise", Trial(noise=loud))
    for share in (0.05, 0.3, 0.5):
        wrong = DepthNoise(relative=0.01, outliers=share)
        trial = Trial(noise=wrong)
        yield Case(f"{100 * share:g} % outliers of 20 mm", trial, quick=share == 0.3)
    one_sided = Trial(alter=outliers(0.3, 0.05))
    yield Case("30 % outliers 50 mm too far", one_sided, quick=True)
    yield Case("one pixel at 60 m", Trial(alter=outliers(1e-4, 60.0)), "either")


def _nonsense() -> Iterator[Case]:
    alters: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "saturated at 65.535 m": lambda d: np.full_like(d, 65.535),
        "constant 0.5 m": lambda d: np.full_like(d, 0.5),
        "constant 0.02 m": lambda d: np.full_like(d, 0.02),
        "zero": np.zeros_like,
        "infinite": lambda d: np.full_like(d, np.inf),
        "negative": np.negative,
        "1e30 m": lambda d: np.full_like(d, 1e30),
        "millimetres for metres": lambda d: 1e3 * d,
        "kilometres for metres": lambda d: 1e-3 * d,
        "uniform random": lambda d: np.random.default_rng(0).uniform(0, 0.3, d.shape),
        "upside down, off the axis": lambda d: np.roll(d[::-1], 60, axis=1),
    }
    for name, alter in alters.items():
        trial = Trial(alter=alter, known=False)
        quick = name in ("millimetres for metres", "constant 0.5 m")
        yield Case(f"depth {name}", trial, "refuse", quick=quick)


def _streams() -> Iterator[Case]:
    yield Case(
        "frozen camera in contact", Trial(depths_m=(0.012,) * 30, frozen=True), "solve", quick=True
    )
    yield Case("frozen camera without contact", Trial(depths_m=(-0.01,) * 30, frozen=True), "solve")
    yield Case("contact and no contact alternating", Trial(depths_m=(0.015, -0.01) * 6), "solve")
    yield Case("sudden deep press", Trial(depths_m=(-0.01, 0.025, 0.002, 0.025)), "solve")


def _formats() -> Iterator[Case]:
    alters: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "float32": lambda d: d.astype("<f4"),
        "big-endian float32": lambda d: d.astype(">f4"),
        "float64": lambda d: d.astype("<f8"),
        "big-endian float64": lambda d: d.astype(">f8"),
        "column-major": np.asfortranarray,
        "not contiguous": lambda d: np.repeat(d, 2, axis=1)[:, ::2],
        "read-only": lambda d: np.broadcast_to(d, d.shape),
    }
    for name, alter in alters.items():
        yield Case(f"image {name}", Trial(alter=alter), "solve", quick="big" in name)
    millimetres = Trial(alter=lambda d: np.nan_to_num(1e3 * d).astype(">u2"), known=False)
    yield Case("image big-endian uint16 in mm, not decoded", millimetres, "refuse", quick=True)


def _bad_input() -> Iterator[Case]:
    nan, inf = float("nan"), float("inf")
    pose, turn = "camera.position_m", "camera.quaternion_xyzw"
    pixel = {"width": 1, "height": 1, "cx": 0.0, "cy": 0.0, "fx": 1.0, "fy": 1.0}
    wrong: dict[str, dict[str, Any]] = {
        "NaN in the sensor pose": {pose: [0.0, nan, -0.104]},
        "NaN in the sensor's quaternion": {turn: [0.0, nan, 0.0, 1.0]},
        "sensor pose in mm": {pose: [0.0, 0.0, -104.0]},
        "quaternion of length 2": {turn: [0.0, 0.0, 0.0, 2.0]},
        "camera turned away": {turn: [1.0, 0.0, 0.0, 0.0]},
        "camera of one pixel": {f"camera.{name}": value for name, value in pixel.items()},
        "tension 0": {"pneumatics.tension_n_per_m": 0.0},
        "tension inf": {"pneumatics.tension_n_per_m": inf},
        "gauge 0": {"pneumatics.gauge_pressure_pa": 0.0},
        "chamber 0": {CHAMBER: 0.0},
        "rim radius in mm": {"membrane.rim_radius_m": 75.0},
    }
    for name, changes in wrong.items():
        must: Must = "either" if name == "camera of one pixel" else "refuse"
        yield Case(name, Trial(changes), must, quick="sensor pose" in name)
    yield Case("NaN in the object's pose", Trial(offset_m=(nan, 0.0)), "refuse")
    cut = Trial(alter=lambda d: d[:-1])
    yield Case("image of the wrong size", cut, "refuse", quick=True)
    yield Case("camera inside the dome", Trial({pose: [0.0, 0.0, 0.02]}))
    yield Case("unknown solver", Trial(options=EstimatorOptions(solver="magic")), "refuse")


def _solvers() -> Iterator[Case]:
    extremes: dict[str, dict[str, Any]] = {
        "ordinary": {},
        "tension 1e-3 N/m": {"pneumatics.tension_n_per_m": 1e-3},
        "tension 1e6 N/m": {"pneumatics.tension_n_per_m": 1e6},
        "chamber 1e-7 m³": {CHAMBER: 1e-7},
    }
    options = EstimatorOptions(solver="paper")
    for name, values in extremes.items():
        must: Must = "either" if values else "solve"
        yield Case(f"paper, {name}", Trial(values, options=options), must)


def _rubber_trial(
    prestretch: float | None = 1.2, sensor: dict[str, Any] | None = None, **changes: Any
) -> Trial:
    """A ball pressed into the exact membrane."""
    own = {"membrane.nodes": 800, "membrane.prestretch": prestretch, **(sensor or {})}
    usual: dict[str, Any] = {"object_name": "sphere", "repeats": 2, "truth_nodes": 2_000}
    return Trial(own, options=EstimatorOptions(solver=RUBBER), **{**usual, **changes})


def _rubber() -> Iterator[Case]:
    yield Case("rubber, λ 1", _rubber_trial(1.0), "refuse")
    for stretch in (1.0001, 1.001, 1.01, 1.05, 1.2, 1.5, 3.0):
        must: Must = "solve" if 1.05 <= stretch <= 1.5 else "either"
        trial = _rubber_trial(stretch)
        yield Case(f"rubber, λ {stretch:g}", trial, must, quick=stretch in (1.0001, 1.5))
    yield Case("rubber, constant tension", _rubber_trial(None))
    for share in (0.02, 0.05, 0.2, 1.2, 1.5):
        height = share * 0.075
        own = {"membrane.height_m": height}
        trial = _rubber_trial(sensor=own, depth_m=min(0.012, 0.5 * height))
        yield Case(f"rubber, dome {100 * share:g} % of the rim radius", trial)
    # Tall, highly stretched domes are beyond the limit pressure; only the enclosed gas is stable.
    for volume in (5e-4, 2.2e-3, 1.0):
        tall = _rubber_trial(1.6, {"membrane.height_m": 0.09, CHAMBER: volume})
        yield Case(f"rubber, over-inflated, chamber {volume:g} m³", tall)
        measured = replace(tall, gas_pressure_pa="true")
        yield Case(f"rubber, over-inflated, chamber {volume:g} m³, gas measured", measured)
    for nodes in (30, 100, 5_000):
        trial = _rubber_trial(sensor={"membrane.nodes": nodes})
        yield Case(f"rubber, {nodes} nodes", trial, limit_s=300.0, quick=nodes == 30)
    for depth in (1e-4, 0.020, 0.030, 0.045):
        yield Case(f"rubber, press of {1e3 * depth:g} mm", _rubber_trial(depth_m=depth))
    yield Case("rubber, two far contacts", _rubber_trial(object_name=two_far_balls), "solve")
    yield Case("rubber, plate", _rubber_trial(object_name=plate, depth_m=0.015))
    by_turns = _rubber_trial(depths_m=(0.012, -0.01) * 3)
    yield Case("rubber, contact and no contact alternating", by_turns, "solve")
    sudden = _rubber_trial(depths_m=(-0.01, 0.020, 0.002, 0.020))
    yield Case("rubber, sudden deep press", sudden)


def _rubber_views() -> Iterator[Case]:
    for side, x in (("visible half", -0.03), ("hidden half", 0.03), ("border", 0.0)):
        trial = _rubber_trial(alter=left_half, offset_m=(x, 0.0))
        yield Case(
            f"rubber, half of the membrane hidden, press on the {side}",
            trial,
            quick=side == "border",
        )
    for mm in (0.0, 0.1, 3.0, 10.0):
        trial = _rubber_trial(noise=DepthNoise(absolute_m=1e-3 * mm))
        yield Case(f"rubber, noise {mm:g} mm", trial)
    yield Case("rubber, gas measured", _rubber_trial(gas_pressure_pa="true"), "solve")
    for off in (-250.0, 250.0):
        wrong = _rubber_trial(gas_pressure_pa=REST_PA + off)
        yield Case(f"rubber, gas measured {off:g} Pa over rest", wrong)
    nonsense = _rubber_trial(alter=lambda d: 1e3 * d, known=False)
    yield Case("rubber, depth millimetres for metres", nonsense, "refuse")
    turned = _rubber_trial(alter=lambda d: np.roll(d[::-1], 60, axis=1), known=False)
    yield Case("rubber, depth image upside down and shifted by 60 pixels", turned, "refuse")
    yield Case("rubber, 2 valid pixels", _rubber_trial(alter=only_pixels(2)))
    outliers = DepthNoise(relative=0.01, outliers=0.3)
    yield Case("rubber, 30 % outliers of 20 mm", _rubber_trial(noise=outliers))


# Extreme objects, meshes and images for the stability study.


def _stack(name: str, sections: list[tuple[float, float, float]]) -> RigidObject:
    """Convex hull of rectangles of half widths x, y at heights z."""
    signs = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float)
    hull = convex_hull(np.concatenate([signs * section for section in sections]))
    return RigidObject(name, np.array(hull.vertices), np.array(hull.faces, np.int64))


def _ball(name: str, radius_m: float) -> RigidObject:
    ball = study_object("sphere")
    return RigidObject(name, ball.vertices * (radius_m / 0.015), ball.triangles)


# Cone of 2 mm radius and 30 mm length with a tip of 0.05 mm; blade 0.2 mm thick; plate wider than
# the sensor; ball small enough to be entirely inside the dome; ball larger than the dome
needle = partial(_stack, "needle", [(5e-5, 5e-5, 0.0), (2e-3, 2e-3, 0.030)])
blade = partial(_stack, "blade", [(0.020, 1e-4, 0.0), (0.020, 1e-4, 0.020)])
plate = partial(_stack, "plate", [(0.15, 0.15, 0.0), (0.15, 0.15, 0.005)])
pellet = partial(_ball, "pellet", 0.004)
large_ball = partial(_ball, "large_ball", 0.060)


def two_far_balls() -> RigidObject:
    """Two balls of radius 9 mm, 80 mm apart."""
    ball = _ball("ball", 0.009)
    sides = [ball.vertices + np.array([x, 0.0, 0.0]) for x in (-0.040, 0.040)]
    triangles = np.concatenate([ball.triangles, ball.triangles + len(ball.vertices)])
    return RigidObject("two_far_balls", np.concatenate(sides), triangles)


def with_slivers(mesh: MembraneMesh, angle_rad: float, count: int = 12) -> MembraneMesh:
    """Mesh with slivers: some nodes are moved towards the opposite edge, down to an angle.

    They are spread over the surface, and leave it by no more than the facets do.
    """
    nodes = mesh.nodes.copy()
    taken = mesh.rim.copy()
    made = 0
    for i, j, k in mesh.triangles[:: max(1, len(mesh.triangles) // (4 * count))]:
        if made == count or taken[[i, j, k]].any():
            continue
        middle, half = 0.5 * (nodes[j] + nodes[k]), 0.5 * np.linalg.norm(nodes[k] - nodes[j])
        up = nodes[i] - middle
        nodes[i] = middle + up / np.linalg.norm(up) * half * np.tan(angle_rad)
        around = np.any(np.isin(mesh.triangles, [i, j, k]), axis=1)
        taken[mesh.triangles[around]] = True
        made += 1
    return MembraneMesh(nodes, mesh.triangles, mesh.rim)


def _only(depth_m: np.ndarray, where: Any) -> np.ndarray:
    kept = np.full_like(depth_m, np.nan)
    kept[where] = depth_m[where]
    return kept


def only_pixels(count: int) -> Alter:
    """Keep `count` adjacent pixels in the middle of the image."""

    def alter(depth_m: np.ndarray) -> np.ndarray:
        row, column = depth_m.shape[0] // 2, depth_m.shape[1] // 2
        return _only(depth_m, np.s_[row, column : column + count])

    return alter


def every(step: int) -> Alter:
    """Keep every `step`-th pixel of every `step`-th row."""
    return lambda depth_m: _only(depth_m, np.s_[::step, ::step])


def left_half(depth_m: np.ndarray) -> np.ndarray:
    """Remove the right half of the image."""
    return _only(depth_m, np.s_[:, : depth_m.shape[1] // 2])


def outliers(share: float, error_m: float) -> Alter:
    """Add an error to a share of the pixels."""

    def alter(depth_m: np.ndarray) -> np.ndarray:
        wrong = np.random.default_rng(1).random(depth_m.shape) < share
        return np.where(wrong, depth_m + np.float32(error_m), depth_m)

    return alter
