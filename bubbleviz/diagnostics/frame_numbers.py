"""Scalar values of a frame that are plotted over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bubbleviz.diagnostics.shear_numbers import ShearNumbers
from bubbleviz.frames.measured_force import force_of
from bubbleviz.membrane.gas import Gas
from bubbleviz.result import Patch, Result

NOTHING = float("nan")


@dataclass(frozen=True)
class Numbers:
    """Numbers of one frame, SI but for the times; NaN where not requested or unknown."""

    status: str = ""  # of the estimate; empty without one
    # p_v that the gas law (Eq. 6) gives for the estimated shape; 0 without contact, whose shape is
    # no measured one: a measured p_v of a drift, or of a touch too faint to be found, inflates it,
    # and its volume would say a p_v of the other sign and a dozen times as large.
    gas_law_pa: float = NOTHING
    gas_measured_pa: float = NOTHING  # measured gas pressure less the reference pressure P0
    # residual_m, solve_ms, total_ms: as in `Estimate` and `Result.times_ms`
    residual_m: float = NOTHING
    solve_ms: float = NOTHING
    total_ms: float = NOTHING
    # force_n, area_m2: length of the force vector; area of the patch
    force_n: float = NOTHING
    force_half_width_n: float = NOTHING  # half of the 95 % interval of the former
    # force of the recording's wrench, as recorded
    wrench_n: tuple[float, float, float] = (NOTHING, NOTHING, NOTHING)
    area_m2: float = NOTHING
    center_m: tuple[float, float, float] = (NOTHING, NOTHING, NOTHING)  # centre of pressure in B
    has_patch: bool = False
    has_shear: bool = False
    # depth image received → products in the window; NaN for frames not shown live
    latency_ms: float = NOTHING
    # shear_normal_n, shear_tangential_n: force with friction, across and along the membrane; NaN
    # where it is not known
    shear_normal_n: float = NOTHING
    shear_tangential_n: float = NOTHING
    shear_tangential_half_n: float = NOTHING  # half of the 95 % interval of the latter
    slip_share: float = NOTHING  # of the patch


def numbers_of(result: Result, gas: Gas) -> Numbers:
    """Numbers of a result; what it lacks is NaN."""
    estimate, measured = result.estimate, result.frame.gas_pressure_pa
    known: dict[str, Any] = {
        "gas_measured_pa": NOTHING if measured is None else measured - gas.P0,
        "wrench_n": tuple(force_of(result.frame.wrench).tolist()),
        "total_ms": result.times_ms.get("total", NOTHING),
    }
    if estimate is not None:
        known |= {
            "status": estimate.status,
            "solve_ms": estimate.solve_ms,
        }
        if estimate.trusted:
            exact = estimate.gas_law_pa
            known["residual_m"] = estimate.residual_rms_m
            known["force_half_width_n"] = estimate.force_half_width_n
            if estimate.status == "no_contact":
                known["gas_law_pa"] = 0.0
            elif exact is None:
                known["gas_law_pa"] = gas.pressure_change(estimate.displacement_m)
            else:
                known["gas_law_pa"] = exact
        if result.patch is not None:
            known |= patch_numbers(result.patch, trusted=estimate.trusted)
    if result.traction is not None:
        shear = ShearNumbers.of(result.traction, result.slip)
        known |= {
            "has_shear": True,
            "shear_normal_n": shear.normal_n[0],
            "shear_tangential_n": shear.tangential_n[0],
            "shear_tangential_half_n": shear.tangential_n[1],
            "slip_share": shear.slip_share[0],
        }
    return Numbers(**known)


def patch_numbers(patch: Patch, *, trusted: bool) -> dict[str, Any]:
    """The numbers that change with κ; NaN where the estimate is not to be trusted."""
    x, y, z = (float(c) for c in patch.center_of_pressure_m)
    return {
        "has_patch": True,
        "force_n": float(np.linalg.norm(patch.force_n)) if trusted else NOTHING,
        "area_m2": patch.area_m2 if trusted else NOTHING,
        "center_m": (x, y, z) if trusted else (NOTHING, NOTHING, NOTHING),
    }
