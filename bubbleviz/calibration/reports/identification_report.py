"""The report of an identification: numbers as JSON, and one HTML file that holds everything."""

from __future__ import annotations

import json
import platform
from dataclasses import asdict
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import bubbleviz
from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.reports.pixel_images import before_after, local_tension_image
from bubbleviz.calibration.reports.rectification_report import (
    rectification_numbers,
    rectification_rows,
)
from bubbleviz.calibration.reports.validation_report import (
    validation_advice,
    validation_numbers,
    validation_pictures,
    validation_rows,
)
from bubbleviz.calibration.reports.verdict import judge
from bubbleviz.calibration.reports.wrench_report import wrench_advice, wrench_numbers, wrench_rows
from bubbleviz.calibration.sensor_writer import Origin
from bubbleviz.calibration.tension.wrench_tension import WrenchTension
from bubbleviz.calibration.validation import Validation
from bubbleviz.files.output_files import whole_file
from bubbleviz.files.png_writer import coloured, data_uri

_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;
color:#222;background:#fff}table{border-collapse:collapse;margin:1rem 0}td,th{padding:.2rem .8rem;
border-bottom:1px solid #ddd;text-align:left}figure{display:inline-block;margin:.5rem 1rem .5rem 0;
width:29rem;vertical-align:top}img{width:100%;image-rendering:pixelated}figcaption{font-size:13px;
color:#555}.good{color:#1a7f37}.usable{color:#9a6700}.doubtful{color:#b42318}code{font-size:12px}"""


def summary(
    found: Identification,
    origin: Origin,
    by_wrench: WrenchTension | None = None,
    validation: Validation | None = None,
) -> dict[str, Any]:
    """All numbers of an identification, SI units, ready for JSON.

    Parameters
    ----------
    found : Identification
    origin : Origin
    by_wrench : WrenchTension, optional
        The second estimate of γ0, where there is one.
    validation : Validation, optional
        By a known object at a known pose, where there is one.
    """
    verdict, tension, surfaces = judge(found), found.tension, found.surfaces
    statistics, fits = found.statistics, found.fits
    chamber = found.chamber
    return {
        "verdict": asdict(verdict)
        | {
            "advice": [
                *verdict.advice,
                *wrench_advice(by_wrench, tension.tension.value),
                *validation_advice(validation),
            ]
        },
        "origin": asdict(origin),
        "versions": versions(),
        "contact_free": {"first": found.samples.frames[0], "last": found.samples.frames[-1]}
        | {"frames": statistics.frames, "effective_frames": statistics.effective_frames},
        "tension_n_per_m": _interval(tension.tension),
        "tension_parts_n_per_m": tension.parts,
        "tension_by_surface_n_per_m": tension.by_surface,
        "tension_least_squares_n_per_m": tension.least_squares_n_per_m,
        "tension_per_pascal_m": tension.per_pascal,
        "tension_by_wrench": wrench_numbers(by_wrench),
        "validation": validation_numbers(validation),
        "rectification": rectification_numbers(found),
        "gauge_pressure_pa": tension.gauge_pressure_pa,
        "gauge_pressure_measured": found.samples.gas_pressure_pa is not None,
        "surface": surfaces.chosen,
        "dimensions": {name: _interval(each) for name, each in tension.dimensions.items()},
        "left_out_rms_m": surfaces.left_out_rms_m,
        "residual_rms_m": float(np.sqrt(np.mean(surfaces.residual_m[found.pixels.mask] ** 2))),
        "ellipsoid": {
            "semi_axes_m": fits.ellipsoid.ellipsoid.semi_axes_m.tolist(),
            "centre_m": fits.ellipsoid.ellipsoid.centre_m.tolist(),
            "tilt_rad": fits.ellipsoid.ellipsoid.tilt_rad,
            "rms_m": fits.ellipsoid.rms_m,
        },
        "rim_height_m": fits.rim_height_m,
        "rim_height_sigma_m": fits.rim_height_sigma_m,
        "seen": found.seen,
        "wander_m": found.wander_m,
        "pixels": {"used": int(found.pixels.mask.sum()), "removed": found.pixels.removed}
        | {"correlated": statistics.correlated_pixels, "quantum_m": statistics.quantum_m}
        | {"noise_median_m": float(np.median(found.pixels.noise_m[found.pixels.mask]))},
        "chamber": None
        if chamber is None
        else {
            "gas_volume_m3": chamber.gas_volume_m3,
            "spread_m3": chamber.spread_m3,
            "chamber_volume_m3": chamber.chamber_volume_m3(found.mesh.cap_volume()),
        },
    }


def versions() -> dict[str, str]:
    """Versions of what computed the numbers."""
    packages = {name: version(name) for name in ("numpy", "scipy")}
    return {"bubbleviz": bubbleviz.__version__, "python": platform.python_version(), **packages}


def write_report(
    found: Identification,
    numbers: dict[str, Any],
    folder: str | Path,
    validation: Validation | None = None,
) -> None:
    """Write `report.html` and `report.json` in a new folder, both or none.

    Parameters
    ----------
    found : Identification
    numbers : dict
        Its `summary`.
    folder : path
    validation : Validation, optional
        For its pictures.

    Raises
    ------
    InputError
        The folder exists or cannot be made.
    """
    with whole_file(folder) as temporary:
        temporary.mkdir()
        (temporary / "report.json").write_text(
            json.dumps(numbers, indent=2, ensure_ascii=False) + "\n", encoding="utf-8"
        )
        (temporary / "report.html").write_text(_html(found, numbers, validation), encoding="utf-8")


def _interval(quantity: Any) -> dict[str, float]:
    return {"value": quantity.value, "low": quantity.low, "high": quantity.high}


def _html(found: Identification, numbers: dict[str, Any], validation: Validation | None) -> str:
    verdict = numbers["verdict"]
    name = escape(found.sensor.name)
    advice = "".join(f"<li>{escape(line)}</li>" for line in verdict["advice"])
    pictures = "".join(
        f'<figure><img alt="{escape(title)}" src="{uri}"><figcaption><b>{escape(title)}</b><br>'
        f"{escape(text)}</figcaption></figure>"
        for title, text, uri in (*_pictures(found), *validation_pictures(validation))
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Calibration of {name}'
        f"</title><style>{_STYLE}</style><h1>Calibration of {name}</h1>"
        f'<p class="{verdict["grade"]}"><b>{escape(verdict["summary"])}</b></p><ul>{advice}</ul>'
        f"<h2>Numbers</h2>{_table(_rows(numbers))}<h2>Pictures</h2>{pictures}"
        f"<h2>Where it comes from</h2>{_table(_origin_rows(numbers))}</html>\n"
    )


def _rows(numbers: dict[str, Any]) -> list[tuple[str, str]]:
    rows = [("γ0", _shown(numbers["tension_n_per_m"], 1.0, "N/m"))]
    rows += [
        (name.removesuffix("_m").replace("_", " "), _shown(each, 1e3, "mm"))
        for name, each in numbers["dimensions"].items()
    ]
    rows += [
        (f"γ0 by the {name}", f"{value:.2f} N/m")
        for name, value in numbers["tension_by_surface_n_per_m"].items()
    ]
    rows += [
        (f"σ of γ0 from {name.replace('_', ' ')}", f"{value:.3g} N/m")
        for name, value in numbers["tension_parts_n_per_m"].items()
    ]
    rows += [
        (f"parts left out are missed by, {name}", f"{1e3 * value:.3g} mm rms")
        for name, value in numbers["left_out_rms_m"].items()
    ]
    rows += wrench_rows(numbers["tension_by_wrench"])
    rows += validation_rows(numbers["validation"])
    rows += rectification_rows(numbers["rectification"])
    contact_free, pixels = numbers["contact_free"], numbers["pixels"]
    rows += [
        ("surface", numbers["surface"]),
        ("residual of the surface", f"{1e3 * numbers['residual_rms_m']:.3g} mm rms"),
        ("gauge pressure", f"{numbers['gauge_pressure_pa']:.1f} Pa"),
        ("γ0 for 100 Pa more", f"{100 * numbers['tension_per_pascal_m']:+.2f} N/m"),
        ("dome seen", f"{100 * numbers['seen']:.0f} %"),
        ("contact-free frames", f"{contact_free['first']}–{contact_free['last']}"),
        ("worth independent frames", f"{contact_free['effective_frames']:.1f}"),
        ("pixels used", f"{pixels['used']}"),
        ("pixels worth one independent", f"{pixels['correlated']:.1f}"),
        ("noise of a pixel", f"{1e3 * pixels['noise_median_m']:.3g} mm"),
    ]
    rows += [(f"pixels out: {name}", str(count)) for name, count in pixels["removed"].items()]
    return rows


def _origin_rows(numbers: dict[str, Any]) -> list[tuple[str, str]]:
    rows = [(name.replace("_", " "), str(value)) for name, value in numbers["origin"].items()]
    return rows + list(numbers["versions"].items())


def _table(rows: list[tuple[str, str]]) -> str:
    cells = "".join(f"<tr><td>{escape(a)}</td><td>{escape(b)}</td></tr>" for a, b in rows)
    return f"<table>{cells}</table>"


def _shown(interval: dict[str, float], scale: float, unit: str) -> str:
    value, half = interval["value"] * scale, 0.5 * scale * (interval["high"] - interval["low"])
    return f"{value:.3f} ± {half:.3f} {unit}"


def _pictures(found: Identification) -> list[tuple[str, str, str]]:
    """Title, explanation and data URI of every picture."""
    statistics, residual, mask = found.statistics, found.surfaces.residual_m, found.pixels.mask
    limit = 3.0 * float(np.std(residual[mask]))
    last = before_after(found)
    noise = statistics.noise_m
    top = float(np.nanpercentile(noise[mask], 99.0))
    local = local_tension_image(found)
    centre = found.tension_n_per_m
    span = f"{1e3 * limit:.2f} mm"
    return [
        ("Validity", "share of frames with a return, 0 to 1", _uri(statistics.validity, 0.0, 1.0)),
        ("Noise", f"σ of one frame's range, 0 to {1e3 * top:.3f} mm", _uri(noise, 0.0, top)),
        ("Pixels used", "bright: used", _uri(mask.astype(float), 0.0, 1.0)),
        (
            "Residual of the surface",
            f"mean range minus surface, −{span} (blue) to +{span} (red)",
            _uri(residual, -limit, limit, True),
        ),
        (
            "Last frame before rectification",
            f"range minus surface, ±{span}",
            _uri(last.before_m, -limit, limit, True),
        ),
        (
            "Last frame after rectification",
            f"the same less each pixel's offset, ±{span}",
            _uri(last.after_m, -limit, limit, True),
        ),
        (
            "Local γ0",
            f"balance of each neighbourhood, {0.8 * centre:.0f} to {1.2 * centre:.0f} N/m",
            _uri(local, 0.8 * centre, 1.2 * centre, True),
        ),
    ]


def _uri(image: np.ndarray, low: float, high: float, diverging: bool = False) -> str:
    return data_uri(coloured(image, low, high, diverging))
