"""Report of an identification: numbers as JSON, and a self-contained HTML file."""

from __future__ import annotations

import json
import os
import platform
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import bubbleviz
from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.material import RubberEstimate
from bubbleviz.calibration.sensor_writer import Origin, file_hash, output_files, write_sensor
from bubbleviz.calibration.validation import Validation
from bubbleviz.calibration.verdict import judge, validation_advice
from bubbleviz.files import refuse_existing, whole_file
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import FrameSource


def summary(
    found: Identification,
    origin: Origin,
    validation: Validation | None = None,  # by a known object at a known pose, where there is one
) -> dict[str, Any]:
    """All numbers of an identification, SI units, ready for JSON."""
    verdict, tension, surfaces = judge(found), found.tension, found.surfaces
    statistics, fits = found.statistics, found.fits
    return {
        "verdict": asdict(verdict) | {"advice": [*verdict.advice, *validation_advice(validation)]},
        "origin": asdict(origin),
        "versions": versions(),
        "contact_free": {"first": found.samples.frames[0], "last": found.samples.frames[-1]}
        | {"frames": statistics.frames, "effective_frames": statistics.effective_frames},
        "tension_n_per_m": _interval(tension.tension),
        "tension_parts_n_per_m": tension.parts,
        "tension_by_surface_n_per_m": tension.by_surface,
        "tension_least_squares_n_per_m": tension.least_squares_n_per_m,
        "tension_per_pascal_m": tension.per_pascal,
        "validation": _validation(validation),
        "rectification": _rectification(found),
        "rubber": _rubber(found.rubber),
        "gauge_pressure_pa": tension.gauge_pressure_pa,
        "gauge_pressure_measured": found.samples.gas_pressure_pa is not None,
        "surface": surfaces.chosen,
        "dimensions": {name: _interval(each) for name, each in tension.dimensions.items()},
        "left_out_rms_m": surfaces.left_out_rms_m,
        "residual_rms_m": float(np.sqrt(np.mean(surfaces.residual_m[found.pixels.mask] ** 2))),
        "ellipsoid": {
            "semi_axes_m": fits.ellipsoid.semi_axes_m.tolist(),
            "centre_m": fits.ellipsoid.centre_m.tolist(),
            "tilt_rad": fits.ellipsoid.tilt_rad,
            "rms_m": fits.ellipsoid.rms_m,
        },
        "rim_height_m": fits.rim_height_m,
        "rim_height_sigma_m": fits.rim_height_sigma_m,
        "seen": found.seen,
        "wander_m": found.wander_m,
        "pixels": {"used": int(found.pixels.mask.sum()), "removed": found.pixels.removed}
        | {"correlated": statistics.correlated_pixels, "quantum_m": statistics.quantum_m}
        | {"noise_median_m": float(np.median(found.pixels.noise_m[found.pixels.mask]))},
    }


def versions() -> dict[str, str]:
    """Versions of what computed the numbers."""
    packages = {name: version(name) for name in ("numpy", "scipy")}
    return {"bubbleviz": bubbleviz.__version__, "python": platform.python_version(), **packages}


def write_report(
    found: Identification,
    numbers: dict[str, Any],  # its `summary`
    folder: str | Path,
    validation: Validation | None = None,  # for its pictures
) -> None:
    """Write `report.html` and `report.json` in a new folder, both or none.

    Raises InputError: the folder exists or cannot be made.
    """
    # 0.4 s, which the window starts without
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from bubbleviz.calibration.report_pictures import pictures

    pages = Environment(
        loader=PackageLoader(__package__, ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    pages.filters["length_of"] = np.linalg.norm
    page = pages.get_template("identification_report.html").render(
        name=found.sensor.name, numbers=numbers, pictures=pictures(found, validation)
    )
    text = json.dumps(numbers, indent=2, ensure_ascii=False) + "\n"
    with whole_file(folder) as temporary:
        temporary.mkdir()
        (temporary / "report.json").write_text(text, encoding="utf-8")
        (temporary / "report.html").write_text(page, encoding="utf-8")


def _interval(quantity: Any) -> dict[str, float]:
    return {"value": quantity.value, "low": quantity.low, "high": quantity.high}


def _rectification(found: Identification) -> dict[str, Any]:
    """Levels, and what the line through them says; an offset from one level has no limits."""
    line, mask = found.pixels.line, found.pixels.mask
    if line is None:
        return {"levels": 1}
    return {
        "levels": line.levels,
        "slope_median": float(np.median(line.slope[mask])),
        "slope_spread": float(np.std(line.slope[mask])),
        "span_median_m": float(np.median((line.farthest_m - line.nearest_m)[mask])),
    }


def _rubber(rubber: RubberEstimate | None) -> dict[str, Any] | None:
    """λ and gauge pressure with intervals and what they rest on, SI units, ready for JSON."""
    if rubber is None:
        return None
    told = np.isfinite(rubber.unexplained_rms_m)
    return {
        "prestretch": rubber.prestretch and asdict(rubber.prestretch),
        "prestretch_from": rubber.prestretch_rests_on if rubber.prestretch else None,
        "why_not_determined": rubber.why_not or None,
        "gauge_pressure_pa": rubber.gauge and asdict(rubber.gauge),
        "gauge_from": rubber.gauge_rests_on,
        "from": rubber.told_by if told else None,
        "levels": {
            "rises_pa": list(rubber.rises_pa),
            "change_rms_m": rubber.change_rms_m,
            "unexplained_rms_m": rubber.unexplained_rms_m,
        }
        if told
        else None,
    }


def _validation(validation: Validation | None) -> dict[str, Any] | None:
    """Numbers for JSON, SI units; None where nothing was validated."""
    if validation is None:
        return None
    overlap = validation.patch_overlap
    return {
        "rms_m": validation.rms_m,
        "p95_m": validation.p95_m,
        "untouched_rms_m": validation.untouched_rms_m,
        "points": len(validation.distance_m),
        "patch_overlap": overlap if np.isfinite(overlap) else None,
        "predicted_force_n": validation.predicted_force_n.tolist(),
        "measured_force_n": validation.measured_force_n.tolist(),
    }


# Save an identification: sensor file, mesh, pixels and report, all of them or none.


def check_outputs(out: Path, report: Path | None) -> None:
    """Refuse, before the work, what could not be written after it."""
    output_files(out)
    if report is not None:
        refuse_existing(report)


def save(
    found: Identification,
    source: FrameSource,  # what it was made from; hashed where it is a file
    sensor_file: str,  # what it started from
    out: Path,  # SENSOR.toml; its mesh and pixels go beside it
    report: Path | None,  # new folder
    progress: Progress = quiet,
    validation: Validation | None = None,  # by a known press
) -> dict[str, Any]:
    """Write the sensor at `out` and its report; the numbers of the report.

    Raises InputError: something exists or cannot be written; nothing is written then. Raises
    Cancelled: by `progress`; nothing is written then.
    """
    check_outputs(out, report)
    path = getattr(source, "path", None)
    origin = Origin(
        recording=source.name,
        recording_sha256=None if path is None else file_hash(path),
        sensor_file=sensor_file,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        report=None if report is None else _from(out.parent, report / "report.html"),
    )
    numbers = summary(found, origin, validation)
    progress("writing", 0.0)
    write_sensor(found, out, origin)
    if report is not None:
        try:
            write_report(found, numbers, report, validation)
        except BaseException:
            for each in (out, out.with_suffix(".ply"), out.with_suffix(".npz")):
                each.unlink(missing_ok=True)  # none of them was there before
            raise
    return numbers


def _from(folder: Path, path: Path) -> str:
    """Path as seen from a folder, so that both can be moved together."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # on another drive
        return str(path)
