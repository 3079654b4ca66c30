"""Images of an identification for the window, and the figures of its report."""

from __future__ import annotations

import base64
from io import BytesIO

import numpy as np

from bubbleviz.calibration.identification import Identification
from bubbleviz.membrane import local_tension

_SEQUENTIAL, _DIVERGING = "viridis", "RdBu_r"
_MISSING = "#28282c"  # colour of pixels without a value
_BLUR = 0.1  # of the dome's size: finer variation comes from the flat facets


def before_after(found: Identification) -> tuple[np.ndarray, np.ndarray]:
    """Range of the last contact-free frame minus the surface, before and after rectification.

    Images (H, W), m; NaN outside the pixels in use.
    """
    model, depth = found.model, found.samples.depth_m[-1]
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
