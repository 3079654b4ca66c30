"""Registry of layers, panels, plots and images: titles and required pipeline products."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from bubbleviz.pipeline import Product

Products = frozenset[Product]
NO_PRODUCTS: Products = frozenset()
ESTIMATE: Products = frozenset({"estimate"})
PATCH: Products = frozenset({"estimate", "patch"})


@dataclass(frozen=True)
class LayerKind:
    """A layer of the 3-D view."""

    title: str  # title, tip: In the layers panel
    tip: str
    needs: Products = NO_PRODUCTS  # Computed only while the layer is visible
    by_default: bool = True  # Visible in a new window


LAYERS: Mapping[str, LayerKind] = MappingProxyType(
    {
        "membrane": LayerKind(
            "Membrane",
            "Deformed membrane, coloured by contact pressure p_c; purple: not trusted",
            ESTIMATE,
        ),
        "texture": LayerKind(
            "Texture",
            "Colour image on the deformed membrane;\n"
            "with the layer Membrane, pressure covers it where something touches",
            ESTIMATE | {"texture"},
            by_default=False,
        ),
        "wireframe": LayerKind("Wireframe", "Edges of the membrane's mesh", ESTIMATE, False),
        "contour": LayerKind(
            "Patch contour",
            "Thick: edge of the contact patch;\n"
            "thin: the smallest and the largest patch that noise allows",
            PATCH,
        ),
        "object_patch": LayerKind(
            "Patch by object",
            "Green: patch from the surface of the tracked object at its pose;\n"
            "white (patch contour): patch from the contact pressure alone",
            by_default=False,
        ),
        "compared": LayerKind(
            "Compared outlines",
            "Edges of the patches by settings A and B;\n"
            "only while the Compare panel is in front, on the frame that it has measured",
        ),
        "cloud": LayerKind(
            "Measured points",
            "Depth image as points in the bubble frame",
            frozenset({"cloud"}),
            by_default=False,
        ),
        "force": LayerKind(
            "Force arrow",
            "Total contact force, friction included, at the centre of pressure",
            PATCH,
        ),
        "readout": LayerKind(
            "Readout",
            "Force, its part by friction, peak pressure and patch area, in the view; in\n"
            "brackets the areas of the smallest and the largest patch that noise allows, all\n"
            "measured on the membrane at rest",
            PATCH,
        ),
        "frustum": LayerKind(
            "Camera frustum", "Field of view of the depth camera", by_default=False
        ),
        "rim": LayerKind("Rim", "Where the membrane is clamped"),
        "vectors": LayerKind(
            "Pressure vectors",
            "Contact pressure p_c as an arrow at each node, along the normal",
            ESTIMATE,
            by_default=False,
        ),
        "traction": LayerKind(
            "Traction",
            "Contact traction at the nodes in contact:\n"
            "normal orange, tangential blue",
            ESTIMATE | {"traction"},
            by_default=False,
        ),
        "object": LayerKind(
            "Object",
            "Object of the Pose panel at its pose or initial pose;\n"
            "grey: not fitted, amber: some directions not determined, red: not found in this frame",
        ),
        "fit": LayerKind(
            "Fit",
            "Contact points by distance from the object, −1 mm (inside) blue to 1 mm red;\n"
            "arrows: directions not determined",
        ),
        "axes": LayerKind(
            "Axes and scale",
            "Axes of the bubble frame, and a scale bar valid at the centre of rotation",
        ),
    }
)  # fmt: skip
"""By name, in the order of the layers panel; drawn by the class of that name in `view3d`."""


@dataclass(frozen=True)
class PanelKind:
    """A panel of the window."""

    title: str  # Of its dock
    needs: Products = NO_PRODUCTS  # Computed only while the panel is in front
    side: Literal["right", "bottom", "left"] | None = "right"  # Initial side; None: not a dock
    tab_of: str = ""  # Panel to which it is added as a tab; images only in a narrow window
    by_default: bool = False  # Open in a new window


PANELS: Mapping[str, PanelKind] = MappingProxyType(
    {
        "layers": PanelKind("Layers", by_default=True),
        "kappa": PanelKind("Contact patch", PATCH, by_default=True),
        "threshold": PanelKind("Threshold", PATCH, tab_of="kappa"),
        "compare": PanelKind("Compare", tab_of="kappa"),
        "tools": PanelKind("3-D tools", tab_of="layers"),
        "sensor": PanelKind("Sensor", tab_of="layers"),
        "pose": PanelKind("Pose", tab_of="kappa"),
        "shear": PanelKind("Shear", frozenset({"traction", "slip"}), tab_of="kappa"),
        "calibration": PanelKind("Calibration", tab_of="layers"),
        "plots": PanelKind("Plots", side="bottom"),
        "images": PanelKind("Images", side="left", tab_of="plots"),
        "playback": PanelKind("Playback", side="bottom", by_default=True),
        "status": PanelKind("Status bar", PATCH, side=None, by_default=True),
    }
)
"""By name, in the order of the View menu."""


@dataclass(frozen=True)
class PlotKind:
    """A plot of the plots panel."""

    title: str  # In its menu
    needs: Products  # Computed for every frame while it is shown


PLOTS: Mapping[str, PlotKind] = MappingProxyType(
    {
        "force": PlotKind("Force", PATCH),
        "wrench": PlotKind("Force over wrench", PATCH),
        "gas": PlotKind("Gas pressure change p_v", ESTIMATE),
        "area": PlotKind("Patch area", PATCH),
        "center": PlotKind("Centre of pressure", PATCH),
        "residual": PlotKind("Residual rms", ESTIMATE),
        "solve": PlotKind("Run time", PATCH),
        "shear": PlotKind("Force with friction", frozenset({"traction"})),
        "slip": PlotKind("Slipping share", frozenset({"slip"})),
        "latency": PlotKind("Latency", NO_PRODUCTS),
        "kappa": PlotKind("κ-curve", ESTIMATE),
    }
)
"""By name, in the order of their menu."""

Colouring = Literal["range", "around zero", "mask", "colour"]


@dataclass(frozen=True)
class ImageKind:
    """An image of the images panel."""

    title: str  # In its menu
    colouring: Colouring
    unit: str = ""  # Attribute of `Units`; empty for a mask or colours


IMAGES: Mapping[str, ImageKind] = MappingProxyType(
    {
        "depth": ImageKind("Depth", "range", "length"),
        "change": ImageKind("Change from rest", "around zero", "length"),
        "residual": ImageKind("Residual", "around zero", "fine_length"),
        "noise": ImageKind("Noise σ", "range", "fine_length"),
        "used": ImageKind("Pixels used", "mask"),
        "patch": ImageKind("Contact patch", "mask"),
        "colour": ImageKind("Colour", "colour"),
        "flow": ImageKind("Optical flow", "range", "pixels"),
    }
)
"""By name, in the order of their menu."""
