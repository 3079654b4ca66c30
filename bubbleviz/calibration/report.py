"""Files of an identification: sensor file, mesh, pixel images, and report."""

from __future__ import annotations

import base64
import platform
from contextlib import ExitStack
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

import bubbleviz
from bubbleviz.calibration.identification import RUBBER_NAMES, Identification
from bubbleviz.calibration.verdict import advice, grade, headline, parameters
from bubbleviz.files import (
    file_hash,
    portable_path,
    refuse_existing,
    restore_on_error,
    whole_file,
    write_json,
    write_ply,
)
from bubbleviz.membrane import local_tension
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

    Raises InputError: another suffix, or one exists and may not be overwritten.
    """
    path = Path(out_toml)
    refuse_existing(path, ".toml", overwrite=overwrite)
    others = [path.with_suffix(".ply"), path.with_suffix(".npz"), *filter(None, [report])]
    for each in others:
        refuse_existing(each, overwrite=overwrite)
    return [path, *others]


def write_sensor(
    found: Identification,
    out_toml: str | Path,
    report: Path | None = None,  # new folder for `report.html` and `report.json`
    *,
    source: FrameSource | None = None,  # its frames; hashed where it is a file
    sensor_file: str | None = None,  # the sensor file before identification
    overwrite: bool = False,
    progress: Progress = quiet,
) -> dict[str, Any]:
    r"""Write `X.toml`, `X.npz`, for a mesh surface `X.ply`, and the report, all or none.

    The shipped Punyo preset is made by (move the old files away first)::

        bubbleviz identify punyo_press_a --sensor OLD/punyo_oval_d405.toml \
            --out presets/sensors/punyo_oval_d405.toml

    which keeps the rim plane, camera axes and name of the old preset. OLD must not know the
    gauge pressure found from the same press: delete gauge_sigma_pa and atmospheric_pressure_pa, and
    write gauge_pressure_pa = 5258, the recorded pressure minus the standard atmosphere.

    Returns
    -------
    dict
        The numbers of the report.

    Raises
    ------
    InputError
        A file exists, or cannot be written; then nothing is written.
    Cancelled
        By `progress`, before anything is written.
    """
    path = Path(out_toml)
    files = output_files(path, report, overwrite=overwrite)
    _, mesh_path, pixels_path, *_ = files
    recording = getattr(source, "path", None)
    origin: Origin = {
        "recording": found.samples.source_name,
        "recording_sha256": None if recording is None else file_hash(recording),
        "sensor_file": sensor_file,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "report": None if report is None else portable_path(report / "report.html", path.parent),
    }
    progress("writing", 0.0)
    sensor, numbers = _described(found, path, origin), summary(found, origin)
    with restore_on_error(*files), ExitStack() as stack:
        # Files appear in reverse order: the sensor file last, after the files that it names.
        toml = stack.enter_context(whole_file(path))
        if sensor.membrane.mesh_file is not None:
            mesh, ply = found.mesh, stack.enter_context(whole_file(mesh_path))
            write_ply(ply, mesh.nodes, {}, mesh.triangles, _MESH_COMMENT)
        found.pixels.save(stack.enter_context(whole_file(pixels_path)))
        toml.write_text(_comment(found) + sensor_to_toml(sensor), encoding="utf-8")
        if report is not None:
            write_report(found, numbers, stack.enter_context(whole_file(report)))
    return numbers


def _described(found: Identification, path: Path, origin: Origin) -> Sensor:
    sensor, tension, gauge = found.sensor, found.tension.possible(), found.gauge.possible()
    membrane = sensor.membrane
    if membrane.mesh_file is not None:
        membrane = membrane.model_copy(update={"mesh_file": path.with_suffix(".ply").name})
    known: dict[str, Any] = {k: value for k, value in origin.items() if k != "sensor_file"}
    for name, of in found.rubber.items():
        known[f"{name}_interval"] = round(of.low, 4), round(of.high, 4)
        known["prestretch_from"] = of.source
    for name, of in found.focal_by_rim_px.items():
        known[f"{name}_interval"] = round(of.low, 2), round(of.high, 2)
    calibration = Calibration(
        pixels_file=path.with_suffix(".npz").name,
        tension_interval_n_per_m=(round(tension.low, 3), round(tension.high, 3)),
        gauge_interval_pa=(round(gauge.low, 1), round(gauge.high, 1)),
        gauge_from=gauge.source,
        **known,
    )
    where = {"folder": path.parent, "file": path.name}
    return sensor.model_copy(update={"membrane": membrane, "calibration": calibration, **where})


def _comment(found: Identification) -> str:
    """Sources of the numbers, as TOML comment lines."""
    free = found.samples.frames
    lines = [
        f"Identified from {found.samples.source_name}, contact-free frames within "
        f"{free[0]}–{free[-1]}.",
        "B: origin at the centre of the rim plane; rim plane and axes follow from the camera pose "
        "in the initial sensor file.",
        advice(found)[0],
        *("{name}: {value} ({source}).".format(**row) for row in parameters(found)),
    ]
    return "".join(f"# {line}\n" for line in lines) + "\n"


def summary(found: Identification, origin: Origin) -> dict[str, Any]:
    """All numbers of an identification, SI units, ready for JSON."""
    surfaces = found.surfaces
    statistics, cap = found.samples.statistics, surfaces.cap
    return {
        "verdict": {
            "grade": grade(found),
            "summary": headline(found),
            "advice": advice(found),
            "parameters": parameters(found),
        },
        "origin": origin,
        "versions": versions(),
        "contact_free": {"first": found.samples.frames[0], "last": found.samples.frames[-1]}
        | {"frames": statistics.frames, "effective_frames": statistics.effective_frames},
        "tension_n_per_m": asdict(found.tension.possible()),
        "tension_parts_n_per_m": found.tension_parts,
        "tension_by_surface_n_per_m": found.tension_by_surface,
        "tension_per_pascal_m": surfaces.tension_m.value,
        "reference_force_n": found.reference_force and asdict(found.reference_force),
        "validation": _validation(found),
        "rectification": _rectification(found),
        "rubber": _rubber(found),
        "gauge_pressure_pa": found.gauge.value,
        "gauge_pressure_measured": found.samples.gas_pressure_pa is not None,
        "surface": surfaces.chosen,
        "dimensions": {name: asdict(each) for name, each in surfaces.dimensions.items()},
        "left_out_rms_m": surfaces.left_out_rms_m,
        "residual_rms_m": float(np.sqrt(np.mean(surfaces.residual_m[found.pixels.mask] ** 2))),
        "ellipsoid": {name: value.tolist() for name, value in asdict(cap).items()},
        "rim_height_m": surfaces.rim_height_m,
        "rim_height_sigma_m": surfaces.rim_height_sigma_m,
        "focal_by_rim_px": {name: asdict(each) for name, each in found.focal_by_rim_px.items()},
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
    folder: Path,
) -> None:
    """Write `report.html` and `report.json` in a new folder."""
    # takes 0.4 s, so not when the window starts
    from jinja2 import Environment, PackageLoader, StrictUndefined

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
    folder.mkdir()
    write_json(folder / "report.json", numbers)
    (folder / "report.html").write_text(page, encoding="utf-8")


def _rectification(found: Identification) -> dict[str, Any]:
    """Count of levels, and slope and span of the line through them."""
    line, mask = found.pixels.line, found.pixels.mask
    if line is None:
        return {"levels": 1}
    names = "slope_median", "slope_spread", "span_median_m"
    return {"levels": line.levels, **dict(zip(names, line.typical(mask), strict=True))}


def _rubber(found: Identification) -> dict[str, Any]:
    """λ and gauge pressure with intervals and sources, SI units, ready for JSON."""
    gauge = found.gauge if found.vented or found.gauge_candidates else None
    fitted = np.isfinite(found.unexplained_rms_m)
    names = "rises_pa", "change_rms_m", "unexplained_rms_m"
    return {
        **dict.fromkeys(RUBBER_NAMES),
        **{name: asdict(each) for name, each in found.rubber.items()},
        "prestretch_from": found.prestretch and found.prestretch.source,
        "why_not_determined": found.why_not or None,
        "gauge_pressure_pa": gauge and asdict(gauge.possible()),
        "gauge_from": found.gauge.source,
        "from": found.shapes_kind if fitted else None,
        "levels": {name: getattr(found, name) for name in names} if fitted else None,
    }


def _validation(found: Identification) -> dict[str, Any] | None:
    if (press := found.validation) is None:
        return None
    names = "rms_m", "p95_m", "untouched_rms_m", "patch_overlap"
    forces = "predicted_force_n", "measured_force_n"
    numbers = {name: getattr(press, name) for name in names}
    numbers |= {"points": len(press.points_m), "estimated": press.estimated}
    if np.isnan(press.patch_overlap):
        numbers["patch_overlap"] = None
    return numbers | {name: getattr(press, name).tolist() for name in forces}


# Images of an identification for the window, and the figures of its report.


_SEQUENTIAL, _DIVERGING = "viridis", "RdBu_r"
_MISSING = "#28282c"  # colour of pixels without a value
_BLUR = 0.1  # of the dome's size: finer variation comes from the flat facets


def before_after(found: Identification) -> tuple[np.ndarray, np.ndarray]:
    """Range of the last contact-free frame minus the surface, before and after rectification.

    Images (H, W), m; NaN outside the pixels in use.
    """
    model, depth = found.model, found.samples.last_depth_m
    before = np.where(found.pixels.mask, model.camera.range_image(depth), np.nan)
    return before - found.modelled_range_m, model.range_image(depth) - found.modelled_range_m


def local_tension_image(found: Identification) -> np.ndarray:
    """γ0 by the force balance of each pixel's neighbourhood, (H, W), N/m."""
    scale = _BLUR * float(np.sqrt(found.mesh.areas.sum()))
    field = local_tension(found.mesh, found.gauge.value, scale)
    hits = found.model.view.hits(np.zeros(len(field)))
    image = np.full(found.pixels.mask.shape, np.nan)
    image.ravel()[hits.ray] = hits.values(field, found.mesh.triangles)
    return image


def pictures(found: Identification) -> list[dict[str, str]]:
    """Figures of the report: title, text, and data URI of each."""
    statistics, mask = found.samples.statistics, found.pixels.mask
    residual = found.surfaces.residual_m
    noise, press = 1e3 * statistics.noise_m, found.validation
    (before, after), tension = before_after(found), found.tension_n_per_m
    share, limit = (0.0, 1.0), 3e3 * float(np.std(residual[mask]))
    around = -limit, limit
    images: list[tuple[str, str, np.ndarray, str, tuple[float, float]]] = [
        ("Validity", "share of frames with valid depth", statistics.validity, "", share),
        ("Noise", "standard deviation of the range in one frame", noise, "mm",
         (0.0, float(np.nanpercentile(noise[mask], 99.0)))),
        ("Pixels used", "bright: used", mask.astype(float), "", share),
        ("Residual of the surface", "mean range minus surface", 1e3 * residual, "mm", around),
        ("Last frame before rectification", "range minus surface", 1e3 * before, "mm", around),
        ("Last frame after rectification", "rectified range minus surface", 1e3 * after, "mm",
         around),
        ("Local γ0", "force balance around each pixel", local_tension_image(found), "N/m",
         (0.8 * tension, 1.2 * tension)),
    ]  # fmt: skip
    if press is not None:
        limit = 3e3 * max(press.rms_m, 1e-9)
        patches = press.predicted_patch + 2.0 * press.measured_patch
        images += [
            ("Known press: distance of the measured points",
             "from the predicted membrane; negative: inside it", 1e3 * press.distance_m, "mm",
             (-limit, limit)),
            ("Known press: patches", "0 none, 1 predicted only, 2 estimated only, 3 both", patches,
             "", (0.0, 3.0)),
        ]  # fmt: skip
    return [_picture(*each) for each in images]


def _picture(
    title: str,
    text: str,
    image: np.ndarray,
    unit: str,
    ends: tuple[float, float],  # of the colours: sequential from 0, else diverging
) -> dict[str, str]:
    """Title, text, and data URI of a PNG of an image (H, W) with its colour bar."""
    from matplotlib import colormaps  # takes 0.4 s, so not when the window starts
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 6.0 * image.shape[0] / image.shape[1]), layout="constrained")
    axes = figure.subplots()
    axes.set_axis_off()
    cmap = colormaps[_DIVERGING if ends[0] else _SEQUENTIAL].with_extremes(bad=_MISSING)
    shown = axes.imshow(image, vmin=ends[0], vmax=ends[1], cmap=cmap, interpolation="nearest")
    figure.colorbar(shown, label=unit, shrink=0.9)
    file = BytesIO()
    figure.savefig(file, format="png", dpi=120)
    data = base64.b64encode(file.getvalue()).decode()
    return {"title": title, "text": text, "uri": f"data:image/png;base64,{data}"}
