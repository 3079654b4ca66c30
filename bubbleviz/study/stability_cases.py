"""The stiff and extreme cases of the stability study, by name."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.files.ply_writer import write_ply
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.inverse.solvers.inverse_solver import RUBBER
from bubbleviz.membrane.cap_mesh import mesh_cap, spherical_cap
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.study import extreme_inputs as shapes
from bubbleviz.study.stability_trial import TYPICAL_RANGE_M, Case, Must, Trial

PSI = 6_894.757  # Pa (NIST SP 811)


def all_cases() -> list[Case]:
    """Every case, in the order in which the study runs them."""
    groups = (
        _tension, _gauge, _dome, _chamber, _meshes, _slivers, _contacts, _gas, _noise, _pixels,
        _nonsense, _streams, _formats, _bad_input, _solvers, _rubber, _rubber_views,
    )  # fmt: skip
    return [case for group in groups for case in group()]


def _tension() -> Iterator[Case]:
    for power in range(-3, 7):
        trial = Trial({"pneumatics": {"tension_n_per_m": 10.0**power}})
        must: Must = "solve" if power in (1, 2, 3) else "either"
        yield Case(f"tension 1e{power} N/m", trial, must, quick=power in (-3, 6))


def _gauge() -> Iterator[Case]:
    for psi in (0.001, 0.01, 0.1, 1.0, 10.0):
        pressure = {"gauge_pressure_pa": psi * PSI}
        must: Must = "solve" if 0.1 <= psi <= 1.0 else "either"
        yield Case(f"gauge {psi:g} psi", Trial({"pneumatics": pressure}), must, quick=psi > 5.0)
        held = {**pressure, "tension_n_per_m": 105.0}
        yield Case(f"gauge {psi:g} psi, tension 105 N/m", Trial({"pneumatics": held}))


def _dome() -> Iterator[Case]:
    for share in (0.02, 0.05, 0.2, 0.5, 0.9, 1.0, 1.2, 1.5):
        height = share * 0.075
        trial = Trial({"membrane": {"height_m": height}}, depth_m=min(0.012, 0.5 * height))
        yield Case(f"dome {100 * share:g} % of the rim radius", trial, quick=share in (0.02, 1.5))


def _chamber() -> Iterator[Case]:
    for power in range(-7, 2):
        trial = Trial({"pneumatics": {"chamber_volume_m3": 10.0**power}})
        must: Must = "solve" if power in (-3, -2) else "either"
        yield Case(f"chamber 1e{power} m³", trial, must, quick=power in (-7, 1))
    for power in (-7, 1):
        paper = {"chamber_volume_m3": 10.0**power, "volume_model": "paper"}
        yield Case(f"chamber 1e{power} m³, volume model paper", Trial({"pneumatics": paper}))


def _meshes() -> Iterator[Case]:
    for nodes in (30, 100, 5_000, 10_000, 50_000):
        trial = Trial({"membrane": {"nodes": nodes}})
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
            mesh, gas = shapes.with_slivers(mesh, np.deg2rad(degrees)), {"tension_n_per_m": 105.0}
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "slivers.ply"
            write_ply(path, mesh.nodes, {}, mesh.triangles)
            membrane = {"shape": "mesh", "mesh_file": str(path)}
            return Trial({"membrane": membrane, "pneumatics": gas})()

    return run


def _contacts() -> Iterator[Case]:
    yield Case("needle on one node", Trial(object_name=shapes.needle, depth_m=0.010), quick=True)
    yield Case("blade", Trial(object_name=shapes.blade, depth_m=0.010))
    yield Case("plate over everything", Trial(object_name=shapes.plate, depth_m=0.015), quick=True)
    yield Case("plate, 40 mm of 50", Trial(object_name=shapes.plate, depth_m=0.040))
    inside = Trial(object_name=shapes.pellet, depth_m=0.035)
    yield Case("object wholly inside", inside, quick=True)
    yield Case("object wholly inside, off the axis", replace(inside, offset_m=(0.02, 0.0)))
    for depth in (1e-6, 1e-4, 1e-3):
        yield Case(f"grazing, {1e3 * depth:g} mm", Trial(depth_m=depth), quick=depth == 1e-4)
    deep = Trial(object_name="sphere", depth_m=0.045)
    yield Case("press to 90 % of the height", deep, quick=True)
    yield Case("press to 60 % of the height", replace(deep, depth_m=0.030))
    far = Trial(object_name=shapes.two_far_balls, depth_m=0.010)
    yield Case("two far contacts", far, "solve", quick=True)
    yield Case("hovering object", Trial(depth_m=-0.005), "solve", quick=True)
    yield Case("contact by the rim", Trial(object_name="sphere", offset_m=(0.055, 0.0)))
    yield Case("object on the rim", Trial(object_name="sphere", offset_m=(0.075, 0.0)), "either")
    yield Case("large ball", Trial(object_name=shapes.large_ball, depth_m=0.02), "solve")


def _gas() -> Iterator[Case]:
    P0 = 101_325.0 + 2_585.5
    yield Case("gas pressure measured, true", Trial(gas_pressure_pa="true"), "solve", quick=True)
    yield Case("gas pressure measured, 250 Pa above rest", Trial(gas_pressure_pa=P0 + 250.0))
    values = {
        "nan": np.nan, "inf": np.inf, "-inf": -np.inf, "0 Pa": 0.0, "-1e5 Pa": -1e5,
        "1e9 Pa": 1e9, "1 Pa": 1.0, "in kPa": 1e-3 * P0, "doubled": 2.0 * P0,
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
        declared = {"noise_relative": max(1e-3 * mm / TYPICAL_RANGE_M, 1e-6)}
        trial = Trial({"camera": declared}, noise=noise)
        yield Case(f"noise {mm:g} mm, declared", trial, must)
    correlated = DepthNoise(relative=0.01, correlation_px=8.0)
    yield Case("noise 1 %, correlated over 8 pixels", Trial(noise=correlated))
    quiet = Trial(noise=DepthNoise(absolute_m=1e-2), depth_m=-0.005)
    yield Case("noise 10 mm, no contact", quiet)


def _pixels() -> Iterator[Case]:
    for count in (0, 1, 2, 10):
        must: Must = "refuse" if count == 0 else "either"
        trial = Trial(alter=shapes.only_pixels(count))
        yield Case(f"{count} valid pixels", trial, must, quick=count < 3)
    yield Case("every tenth pixel", Trial(alter=shapes.every(10)))
    yield Case("left half of the image", Trial(alter=shapes.left_half))
    for share in (0.5, 0.9):
        # Blobs of holes come with noise correlated like them, which the sensor file knows not of:
        # as much of it as the file says may be refused, a fifth of it must be borne.
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
    one_sided = Trial(alter=shapes.outliers(0.3, 0.05))
    yield Case("30 % outliers 50 mm too far", one_sided, quick=True)
    yield Case("one pixel at 60 m", Trial(alter=shapes.outliers(1e-4, 60.0)), "either")


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
    yield Case("contact and none by turns", Trial(depths_m=(0.015, -0.01) * 6), "solve")
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
    wrong: dict[str, dict[str, Any]] = {
        "NaN in the sensor pose": {"camera": {"position_m": [0.0, float("nan"), -0.104]}},
        "NaN in the sensor's quaternion": {
            "camera": {"quaternion_xyzw": [0.0, float("nan"), 0.0, 1.0]}
        },
        "sensor pose in mm": {"camera": {"position_m": [0.0, 0.0, -104.0]}},
        "quaternion of length 2": {"camera": {"quaternion_xyzw": [0.0, 0.0, 0.0, 2.0]}},
        "camera turned away": {"camera": {"quaternion_xyzw": [1.0, 0.0, 0.0, 0.0]}},
        "camera of one pixel": {
            "camera": {"width": 1, "height": 1, "cx": 0.0, "cy": 0.0, "fx": 1.0, "fy": 1.0}
        },
        "tension 0": {"pneumatics": {"tension_n_per_m": 0.0}},
        "tension inf": {"pneumatics": {"tension_n_per_m": float("inf")}},
        "gauge 0": {"pneumatics": {"gauge_pressure_pa": 0.0}},
        "chamber 0": {"pneumatics": {"chamber_volume_m3": 0.0}},
        "rim radius in mm": {"membrane": {"rim_radius_m": 75.0}},
    }
    for name, changes in wrong.items():
        must: Must = "either" if name == "camera of one pixel" else "refuse"
        yield Case(name, Trial(changes), must, quick="sensor pose" in name)
    yield Case("NaN in the object's pose", Trial(offset_m=(float("nan"), 0.0)), "refuse")
    cut = Trial(alter=lambda d: d[:-1])
    yield Case("image of the wrong size", cut, "refuse", quick=True)
    yield Case("camera inside the dome", Trial({"camera": {"position_m": [0.0, 0.0, 0.02]}}))
    yield Case("unknown solver", Trial(options=EstimatorOptions(solver="magic")), "refuse")


def _solvers() -> Iterator[Case]:
    extremes: dict[str, dict[str, float]] = {
        "ordinary": {},
        "tension 1e-3 N/m": {"tension_n_per_m": 1e-3},
        "tension 1e6 N/m": {"tension_n_per_m": 1e6},
        "chamber 1e-7 m³": {"chamber_volume_m3": 1e-7},
    }
    options = EstimatorOptions(solver="paper")
    for name, values in extremes.items():
        must: Must = "either" if values else "solve"
        yield Case(f"paper, {name}", Trial({"pneumatics": values}, options=options), must)


def _rubber_trial(
    prestretch: float | None = 1.2,
    membrane: dict[str, Any] | None = None,
    pneumatics: dict[str, Any] | None = None,
    **changes: Any,
) -> Trial:
    """A ball pressed into the exact membrane."""
    sensor = {
        "membrane": {"nodes": 800, "prestretch": prestretch, **(membrane or {})},
        "pneumatics": pneumatics or {},
    }
    usual: dict[str, Any] = {"object_name": "sphere", "repeats": 2, "truth_nodes": 2_000}
    return Trial(sensor, options=EstimatorOptions(solver=RUBBER), **{**usual, **changes})


def _rubber() -> Iterator[Case]:
    yield Case("rubber, λ 1", _rubber_trial(1.0), "refuse")
    for stretch in (1.0001, 1.001, 1.01, 1.05, 1.2, 1.5, 3.0):
        must: Must = "solve" if 1.05 <= stretch <= 1.5 else "either"
        trial = _rubber_trial(stretch)
        yield Case(f"rubber, λ {stretch:g}", trial, must, quick=stretch in (1.0001, 1.5))
    yield Case("rubber, constant tension", _rubber_trial(None))
    for share in (0.02, 0.05, 0.2, 1.2, 1.5):
        height = share * 0.075
        trial = _rubber_trial(membrane={"height_m": height}, depth_m=min(0.012, 0.5 * height))
        yield Case(f"rubber, dome {100 * share:g} % of the rim radius", trial)
    # Tall, far-stretched domes are past the limit pressure: the gas behind them alone holds them.
    for volume in (5e-4, 2.2e-3, 1.0):
        tall = _rubber_trial(1.6, {"height_m": 0.09}, {"chamber_volume_m3": volume})
        yield Case(f"rubber, over-inflated, chamber {volume:g} m³", tall)
        measured = replace(tall, gas_pressure_pa="true")
        yield Case(f"rubber, over-inflated, chamber {volume:g} m³, gas measured", measured)
    for nodes in (30, 100, 5_000):
        trial = _rubber_trial(membrane={"nodes": nodes})
        yield Case(f"rubber, {nodes} nodes", trial, limit_s=300.0, quick=nodes == 30)
    for depth in (1e-4, 0.020, 0.030, 0.045):
        yield Case(f"rubber, press of {1e3 * depth:g} mm", _rubber_trial(depth_m=depth))
    yield Case("rubber, two far contacts", _rubber_trial(object_name=shapes.two_far_balls), "solve")
    yield Case("rubber, plate", _rubber_trial(object_name=shapes.plate, depth_m=0.015))
    by_turns = _rubber_trial(depths_m=(0.012, -0.01) * 3)
    yield Case("rubber, contact and none by turns", by_turns, "solve")
    sudden = _rubber_trial(depths_m=(-0.01, 0.020, 0.002, 0.020))
    yield Case("rubber, sudden deep press", sudden)


def _rubber_views() -> Iterator[Case]:
    for side, x in (("seen", -0.03), ("unseen", 0.03), ("both", 0.0)):
        trial = _rubber_trial(alter=shapes.left_half, offset_m=(x, 0.0))
        yield Case(f"rubber, half unseen, press on {side}", trial, quick=side == "both")
    for mm in (0.0, 0.1, 3.0, 10.0):
        trial = _rubber_trial(noise=DepthNoise(absolute_m=1e-3 * mm))
        yield Case(f"rubber, noise {mm:g} mm", trial)
    yield Case("rubber, gas measured", _rubber_trial(gas_pressure_pa="true"), "solve")
    P0 = 101_325.0 + 2_585.5
    for off in (-250.0, 250.0):
        wrong = _rubber_trial(gas_pressure_pa=P0 + off)
        yield Case(f"rubber, gas measured {off:g} Pa over rest", wrong)
    nonsense = _rubber_trial(alter=lambda d: 1e3 * d, known=False)
    yield Case("rubber, depth millimetres for metres", nonsense, "refuse")
    turned = _rubber_trial(alter=lambda d: np.roll(d[::-1], 60, axis=1), known=False)
    yield Case("rubber, depth upside down, off the axis", turned, "refuse")
    yield Case("rubber, 2 valid pixels", _rubber_trial(alter=shapes.only_pixels(2)))
    outliers = DepthNoise(relative=0.01, outliers=0.3)
    yield Case("rubber, 30 % outliers of 20 mm", _rubber_trial(noise=outliers))
