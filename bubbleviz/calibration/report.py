"""Files of an identification: sensor file, mesh, pixel images, and report."""

from __future__ import annotations

import platform
from contextlib import ExitStack
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import bubbleviz
from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.verdict import judge, parameters
from bubbleviz.errors import InputError
from bubbleviz.files import (
    file_hash,
    portable_path,
    refuse_existing,
    whole_file,
    write_json,
    write_ply,
)
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import FrameSource
from bubbleviz.sensor import Calibration, Sensor, sensor_to_toml

_MESH_COMMENT = "membrane in the bubble frame B, metres"

Origin = dict[str, Any]
"""`recording`, `recording_sha256`, `sensor_file`, `date` (ISO 8601, UTC) and `report`, the path
relative to the sensor file's folder."""


def output_files(
    out_toml: str | Path, report: Path | None = None, *, overwrite: bool = False
) -> list[Path]:
    """Paths of the sensor file, its mesh, its pixel images, and the report if there is one.

    Raises InputError: one exists and may not be overwritten.
    """
    path = Path(out_toml)
    if path.suffix != ".toml":
        raise InputError(f"{path}: the name of a sensor file ends in .toml; give such a name")
    paths = [path, path.with_suffix(".ply"), path.with_suffix(".npz"), *filter(None, [report])]
    for each in paths:
        refuse_existing(each, overwrite=overwrite)
    return paths


def write_sensor(
    found: Identification, out_toml: str | Path, origin: Origin | None = None
) -> Sensor:
    r"""Write `X.toml`, `X.npz` and, for a mesh surface, `X.ply`, all or none; return the sensor.

    The shipped Punyo preset is made by (move the old files away first)::

        bubbleviz identify punyo_press_a --sensor OLD/punyo_oval_d405.toml \
            --out presets/sensors/punyo_oval_d405.toml

    which keeps the rim plane, camera axes and name of the old preset.

    Raises
    ------
    InputError
        A file exists, or cannot be written; then nothing is written.
    """
    path, mesh_path, pixels_path = output_files(out_toml)
    origin = origin or {"recording": found.samples.source_name}
    sensor = _described(found, path, origin)
    with ExitStack() as files:
        # Files appear in reverse order: the sensor file last, after the files that it names.
        toml = files.enter_context(whole_file(path))
        if sensor.membrane.mesh_file is not None:
            mesh, ply = found.mesh, files.enter_context(whole_file(mesh_path))
            write_ply(ply, mesh.nodes, {}, mesh.triangles, _MESH_COMMENT)
        found.pixels.save(files.enter_context(whole_file(pixels_path)))
        toml.write_text(_comment(found) + sensor_to_toml(sensor), encoding="utf-8")
    return sensor


def _described(found: Identification, path: Path, origin: Origin) -> Sensor:
    sensor, tension = found.sensor, found.tension.tension
    membrane = sensor.membrane
    if membrane.mesh_file is not None:
        membrane = membrane.model_copy(update={"mesh_file": path.with_suffix(".ply").name})
    known: dict[str, Any] = {k: value for k, value in origin.items() if k != "sensor_file"}
    if (gauge := found.tension.gauge) is not None:
        known["gauge_interval_pa"] = round(gauge.low, 1), round(gauge.high, 1)
        known["gauge_from"] = found.gauge_source
    if (stretch := found.prestretch) is not None:
        known["prestretch_interval"] = round(stretch.low, 4), round(stretch.high, 4)
        known["prestretch_from"] = found.prestretch_source
    calibration = Calibration(
        pixels_file=path.with_suffix(".npz").name,
        tension_interval_n_per_m=(round(tension.low, 3), round(tension.high, 3)),
        **known,
    )
    where = {"folder": path.parent, "file": path.name}
    return sensor.model_copy(update={"membrane": membrane, "calibration": calibration, **where})


def _comment(found: Identification) -> str:
    """Sources of the numbers, as TOML comment lines."""
    surfaces, tension, free = found.surfaces, found.tension, found.samples.frames
    axes = "/".join(f"{1e3 * x:.1f}" for x in surfaces.cap.semi_axes_m)
    misses = {name: f"{1e3 * rms:.3g} mm" for name, rms in surfaces.left_out_rms_m.items()}
    lines = [
        f"Identified from {found.samples.source_name}, contact-free frames within "
        f"{free[0]}–{free[-1]}.",
        "B: origin at the centre of the rim plane; rim plane and axes follow from the camera pose "
        "in the initial sensor file.",
        "Rms misfit on parts of the cloud that were left out of the fit: sphere"
        f" {misses['sphere']},",
        f"ellipsoid of semi-axes {axes} mm {misses['ellipsoid']}, free form"
        f" {misses['free-form']}. Chosen: {surfaces.chosen}.",
        "γ0 is from Young–Laplace, summed over the surface so that small bumps do not bias it;",
        f"100 Pa more of gauge pressure would make it {100 * tension.per_pascal:.2f} N/m larger.",
    ]
    lines += [f"{each.name}: {each.value} ({each.told_by})." for each in parameters(found)]
    return "".join(f"# {line}\n" for line in lines) + "\n"


def summary(found: Identification, origin: Origin) -> dict[str, Any]:
    """All numbers of an identification, SI units, ready for JSON."""
    verdict, tension, surfaces = judge(found), found.tension, found.surfaces
    statistics, cap = found.samples.statistics, surfaces.cap
    pressed = () if found.validation is None else (found.validation.summary,)
    return {
        "verdict": asdict(verdict) | {"advice": [*verdict.advice, *pressed]},
        "origin": origin,
        "versions": versions(),
        "contact_free": {"first": found.samples.frames[0], "last": found.samples.frames[-1]}
        | {"frames": statistics.frames, "effective_frames": statistics.effective_frames},
        "tension_n_per_m": asdict(tension.tension),
        "tension_parts_n_per_m": tension.parts,
        "tension_by_surface_n_per_m": tension.by_surface,
        "tension_least_squares_n_per_m": tension.least_squares_n_per_m,
        "tension_per_pascal_m": tension.per_pascal,
        "validation": _validation(found),
        "rectification": _rectification(found),
        "rubber": _rubber(found),
        "gauge_pressure_pa": tension.gauge_pressure_pa,
        "gauge_pressure_measured": found.samples.gas_pressure_pa is not None,
        "surface": surfaces.chosen,
        "dimensions": {name: asdict(each) for name, each in tension.dimensions.items()},
        "left_out_rms_m": surfaces.left_out_rms_m,
        "residual_rms_m": float(np.sqrt(np.mean(surfaces.residual_m[found.pixels.mask] ** 2))),
        "ellipsoid": {name: value.tolist() for name, value in asdict(cap).items()},
        "rim_height_m": surfaces.rim_height_m,
        "rim_height_sigma_m": surfaces.rim_height_sigma_m,
        "seen": surfaces.visible_share,
        "wander_m": surfaces.motion_m,
        "pixels": {"used": int(found.pixels.mask.sum()), "removed": found.pixels.removed}
        | {"correlated": statistics.correlated_pixels, "quantum_m": statistics.quantum_m}
        | {"noise_median_m": float(np.median(found.pixels.noise_m[found.pixels.mask]))},
    }


def versions() -> dict[str, str]:
    packages = {name: version(name) for name in ("numpy", "scipy")}
    return {"bubbleviz": bubbleviz.__version__, "python": platform.python_version(), **packages}


def write_report(
    found: Identification,
    numbers: dict[str, Any],  # its `summary`
    folder: str | Path,
) -> None:
    """Write `report.html` and `report.json` in a new folder, both or none.

    Raises InputError: the folder exists or cannot be made.
    """
    # takes 0.4 s, so not when the window starts
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from bubbleviz.calibration.pictures import pictures

    pages = Environment(
        loader=PackageLoader(__package__, ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    pages.filters["length_of"] = np.linalg.norm
    page = pages.get_template("identification_report.html").render(
        name=found.sensor.name, numbers=numbers, pictures=pictures(found)
    )
    with whole_file(folder) as temporary:
        temporary.mkdir()
        write_json(temporary / "report.json", numbers)
        (temporary / "report.html").write_text(page, encoding="utf-8")


def _rectification(found: Identification) -> dict[str, Any]:
    """Count of levels, and slope and span of the line through them."""
    line, mask = found.pixels.line, found.pixels.mask
    if line is None:
        return {"levels": 1}
    names = "slope_median", "slope_spread", "span_median_m"
    return {"levels": line.levels, **dict(zip(names, line.typical(mask), strict=True))}


def _rubber(found: Identification) -> dict[str, Any] | None:
    """λ and gauge pressure with intervals and sources, SI units, ready for JSON."""
    rubber = found.rubber
    if rubber is None:
        return None
    gauge = rubber.gauge if found.vented is None else found.tension.gauge
    fitted = np.isfinite(rubber.unexplained_rms_m)
    names = "rises_pa", "change_rms_m", "unexplained_rms_m"
    return {
        "prestretch": rubber.prestretch and asdict(rubber.prestretch),
        "prestretch_from": found.prestretch_source or None,
        "why_not_determined": rubber.why_not or None,
        "gauge_pressure_pa": gauge and asdict(gauge),
        "gauge_from": found.gauge_source,
        "from": rubber.shapes_kind if fitted else None,
        "levels": {name: getattr(rubber, name) for name in names} if fitted else None,
    }


def _validation(found: Identification) -> dict[str, Any] | None:
    if (validation := found.validation) is None:
        return None
    overlap = validation.patch_overlap
    return {
        "rms_m": validation.rms_m,
        "p95_m": validation.p95_m,
        "untouched_rms_m": validation.untouched_rms_m,
        "points": len(validation.points_m),
        "patch_overlap": overlap if np.isfinite(overlap) else None,
        "predicted_force_n": validation.predicted_force_n.tolist(),
        "measured_force_n": validation.measured_force_n.tolist(),
    }


def save(
    found: Identification,
    source: FrameSource,  # its frames; hashed where it is a file
    sensor_file: str,  # the sensor file before identification
    out: Path,  # SENSOR.toml; its mesh and pixels go into the same folder
    report: Path | None,  # new folder
    progress: Progress = quiet,
) -> dict[str, Any]:
    """Write the sensor to `out`, and its report; returns the numbers of the report.

    Raises InputError: a file exists or cannot be written. Raises Cancelled: by `progress`. Nothing
    is written in either case.
    """
    files = output_files(out, report)
    path = getattr(source, "path", None)
    origin: Origin = {
        "recording": source.name,
        "recording_sha256": None if path is None else file_hash(path),
        "sensor_file": sensor_file,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "report": None if report is None else portable_path(report / "report.html", out.parent),
    }
    numbers = summary(found, origin)
    progress("writing", 0.0)
    write_sensor(found, out, origin)
    if report is not None:
        try:
            write_report(found, numbers, report)
        except BaseException:
            for each in files[:3]:
                each.unlink(missing_ok=True)  # none existed before: `output_files`
            raise
    return numbers
