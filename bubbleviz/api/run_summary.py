"""Statistics of a run, and their text for the terminal."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import compress
from typing import Any

import numpy as np

from bubbleviz.output import PoseRow
from bubbleviz.result import TRUSTED
from bubbleviz.wording import count_of, counted

_LINES = {
    "failure": "why     {}",
    "fit": "fit     {} (medians of {ok_frames})",
    "median_contact_force_n": "force   {:.3g}{plus_minus} N in contact (medians), "
    "{max_force_n:.3g} N highest",
    "median_contact_measured_force_n": "        {:.3g} N median in contact by the wrench sensor, "
    "minus its bias without contact",
    "gas_zero": "{}",
    "model": "model   {}",
    "shear": "shear   {}; force direction not verified on real sensors\n        {texture}",
    "median_total_ms": "time    depth image in → {end}: {:.1f} ms median, "
    "{p95_total_ms:.1f} ms p95",
    "median_contact_total_ms": "        {:.1f} ms median in contact",
    "areas": "patch   {} (medians)",
}
"""Lines of a summary, by the fact that each requires."""


def statistics(
    rows: Sequence[dict[str, Any]],
    half_widths_n: Sequence[float],  # of the 95 % interval of each force
) -> dict[str, Any]:
    """Statistics of frames; None if no frame has the value.

    Run times in ms are over all frames but the first, depth image in → patch out; `solve_ms` is of
    the solver alone. `contact` means frames with a contact patch, `measured_force_n` the force of
    the wrench minus its contact-free bias.
    """
    known = [row for row in rows if row["status"] in TRUSTED]
    touches = [row["patch_area_m2"] > 0.0 for row in rows]
    touching = list(compress(rows, touches))
    warm = rows[1:]
    traction = Counter(row["traction_status"] for row in rows if "traction_status" in row)
    force = _over(known, "force_n")
    return {
        "frames": len(rows),
        "status": dict(Counter(row["status"] for row in rows)),
        "median_total_ms": _known(np.median, _over(warm, "total_ms")),
        "p95_total_ms": _known(_p95, _over(warm, "total_ms")),
        "median_contact_total_ms": _known(
            np.median, [row["total_ms"] for row in warm if row["patch_area_m2"] > 0.0]
        ),
        "median_solve_ms": _known(np.median, _over(warm, "solve_ms")),
        "rms_force_n": _known(lambda sizes: np.sqrt(np.mean(np.square(sizes))), force),
        "median_contact_force_n": _known(np.median, _over(touching, "force_n")),
        "median_contact_half_width_n": _known(np.median, [*compress(half_widths_n, touches)]),
        "max_force_n": _known(np.max, force),
        "median_contact_measured_force_n": _known(np.median, _over(touching, "measured_force_n")),
        "median_residual_rms_m": _known(np.median, _over(known, "residual_rms_m")),
        "max_kkt_residual": _known(np.max, _over(known, "kkt_residual")),
        "traction_status": dict(traction) or None,
    }


def pose_statistics(rows: Sequence[PoseRow]) -> dict[str, Any]:
    """Statistics of poses: medians over `ok` frames, run times without the first."""
    good = [row for row in rows if row["status"] == "ok"]
    areas = [(row["patch_area_m2"], row["object_patch_area_m2"]) for row in good]
    both = [pair for pair in areas if np.isfinite(pair).all()]
    patch, by_object = np.median(both, axis=0).tolist() if both else (None, None)
    times = _over(good[1:], "total_ms")
    return {
        "frames": len(rows),
        "status": dict(Counter(row["status"] for row in rows)),
        "median_fitness": _known(np.median, _over(good, "fitness")),
        "median_rmse_m": _known(np.median, _over(good, "rmse_m")),
        "median_total_ms": _known(np.median, times),
        "p95_total_ms": _known(_p95, times),
        "median_patch_area_m2": patch,
        "median_object_patch_area_m2": by_object,
    }


def text_of(facts: dict[str, Any]) -> str:
    """Text for the terminal of the facts of a run."""
    half_n = facts.get("median_contact_half_width_n")
    plus_minus = "" if half_n is None else f" ± {half_n:.2g}"
    facts = {"end": "patch out, without the first frame", "plus_minus": plus_minus} | facts
    facts |= _pose_texts(facts)
    if facts.get("traction_status"):
        facts["shear"] = counted(facts["traction_status"])
    lines = [] if facts["out"] is None else [f"wrote   {facts['out']}"]
    lines.append(f"frames  {facts['frames']}: {counted(facts['status'])}")
    known = (key for key in _LINES if facts.get(key) is not None)
    return "\n".join([*lines, *(_LINES[key].format(facts[key], **facts) for key in known)])


def _pose_texts(facts: dict[str, Any]) -> dict[str, str]:
    if "object" not in facts:
        return {}
    found = count_of(facts["status"].get("ok", 0), "ok frame")
    texts = {"end": "pose out while tracking", "ok_frames": found}
    if facts["median_rmse_m"] is not None:
        share, rmse_mm = 100.0 * facts["median_fitness"], 1e3 * facts["median_rmse_m"]
        texts["fit"] = f"{share:.0f} % of the patch on the object, rmse {rmse_mm:.2f} mm"
    if facts["median_patch_area_m2"] is not None:
        mm2 = [1e6 * facts[key] for key in ("median_patch_area_m2", "median_object_patch_area_m2")]
        texts["areas"] = f"{mm2[0]:.0f} mm² by the contact pressure, {mm2[1]:.0f} mm² by the object"
    return texts


def _over(rows: Sequence[dict[str, Any]], key: str) -> list[float]:
    """Values of some frames; of vectors the magnitude."""
    return [float(np.linalg.norm(row[key])) if np.ndim(row[key]) else row[key] for row in rows]


def _known(statistic: Callable[[list[float]], Any], values: list[float]) -> float | None:
    """Statistic of finite values; None if there are none, as JSON has no NaN."""
    finite = [value for value in values if math.isfinite(value)]
    return float(statistic(finite)) if finite else None


def _p95(values: list[float]) -> float:
    return float(np.percentile(values, 95.0))
