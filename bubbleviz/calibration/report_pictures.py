"""The pictures of an identification's report, each with its scale, as an HTML page holds them."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.pixel_images import before_after, local_tension_image
from bubbleviz.calibration.validation import Validation

_SEQUENTIAL, _DIVERGING = "viridis", "RdBu_r"
_MISSING = "#28282c"
"""Colour of pixels without a number."""


@dataclass(frozen=True)
class ReportPicture:
    """A picture with a title, a sentence, and its PNG as a data URI."""

    title: str
    text: str
    uri: str


def pictures(found: Identification, validation: Validation | None) -> list[ReportPicture]:
    """Every picture of a report."""
    statistics, residual, mask = found.statistics, found.surfaces.residual_m, found.pixels.mask
    limit = 3.0 * float(np.std(residual[mask]))
    top = float(np.nanpercentile(statistics.noise_m[mask], 99.0))
    (before, after), tension = before_after(found), found.tension_n_per_m
    around = (-1e3 * limit, 1e3 * limit)
    return [
        _picture(
            "Validity", "share of frames with a return", statistics.validity, "", (0.0, 1.0)
        ),
        _picture("Noise", "σ of one frame's range", 1e3 * statistics.noise_m, "mm", (0, 1e3 * top)),
        _picture("Pixels used", "bright: used", mask.astype(float), "", (0.0, 1.0)),
        _picture("Residual of the surface", "mean range minus surface", 1e3 * residual, "mm",
                 around, _DIVERGING),
        _picture("Last frame before rectification", "range minus surface", 1e3 * before,
                 "mm", around, _DIVERGING),
        _picture("Last frame after rectification", "the same less each pixel's offset",
                 1e3 * after, "mm", around, _DIVERGING),
        _picture("Local γ0", "balance of each neighbourhood", local_tension_image(found), "N/m",
                 (0.8 * tension, 1.2 * tension), _DIVERGING),
        *([] if validation is None else _of_validation(validation)),
    ]  # fmt: skip


def _of_validation(validation: Validation) -> list[ReportPicture]:
    limit = 1e3 * max(3.0 * validation.rms_m, 1e-9)
    patches = validation.predicted_patch + 2.0 * validation.measured_patch
    return [
        _picture("Known press: distance of the cloud", "from the predicted membrane, inside: < 0",
                 1e3 * validation.distance_image_m, "mm", (-limit, limit), _DIVERGING),
        _picture("Known press: patches", "0: none, 1: only predicted, 2: only estimated, 3: both",
                 patches, "", (0.0, 3.0)),
    ]  # fmt: skip


def _picture(
    title: str,
    text: str,
    image: np.ndarray,
    unit: str,
    ends: tuple[float, float],
    colours: str = _SEQUENTIAL,
) -> ReportPicture:
    """An image (H, W) in a unit, with its colour bar."""
    figure = Figure(figsize=(6.0, 6.0 * image.shape[0] / image.shape[1]), layout="constrained")
    axes = figure.subplots()
    axes.set_axis_off()
    cmap = colormaps[colours].with_extremes(bad=_MISSING)
    shown = axes.imshow(image, vmin=ends[0], vmax=ends[1], cmap=cmap, interpolation="nearest")
    figure.colorbar(shown, label=unit, shrink=0.9)
    file = BytesIO()
    figure.savefig(file, format="png", dpi=120)
    data = base64.b64encode(file.getvalue()).decode()
    return ReportPicture(title, text, f"data:image/png;base64,{data}")
