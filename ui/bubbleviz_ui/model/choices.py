"""What the user chose; it outlives new data. No Qt in here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

CloudColour = Literal["residual", "patch", "plain"]
Axis = Literal["x", "y", "z"]
ColourMap = Literal["inferno", "viridis", "cividis", "magma", "plasma"]
COLOUR_MAPS: tuple[ColourMap, ...] = ("inferno", "viridis", "cividis", "magma", "plasma")
"""All perceptually uniform (van der Walt and Smith 2015; Nuñez 2018)."""
ImageName = Literal["depth", "change", "residual", "noise", "used", "patch"]
ThemeName = Literal["system", "dark", "light"]

LAYERS = ("membrane", "wireframe", "contour", "cloud", "force", "readout", "frustum", "rim",
          "vectors", "object", "fit")  # fmt: skip
"""Names of the 3-D layers, in the order the panel lists them."""


SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Playback speeds to choose from."""
PATCH_CHOICES = frozenset({"kappa", "least_area_m2"})
"""Choices that make another patch of the same contact pressure."""
POSE_CHOICES = frozenset({"pose_object", "pose_unit"})
"""Choices that make it another object."""
PRE_ROLL_S = 2.0
LOOPBACK = "tcp/127.0.0.1:7448"
"""Where results are published unless told otherwise: this computer only."""


@dataclass(frozen=True)
class Setting:
    """A setting of the estimator to compare; None is bubbleviz's default.

    Attributes
    ----------
    solver : str or None
    pressure_scale : float or None
        Contact pressure expected, in gauge pressures.
    recasts : int or None
        How often rays are cast again in a frame.
    nodes : int or None
        Of the mesh; None: the sensor's.
    block : int or None
        Side of the squares of pixels that are averaged.
    """

    solver: str | None = None
    pressure_scale: float | None = None
    recasts: int | None = None
    nodes: int | None = None
    block: int | None = None


@dataclass(frozen=True)
class Choices:
    """What the user chose; it outlives new data.

    Attributes
    ----------
    kappa : float or None
        Patch threshold, multiple of the mean contact pressure; None for bubbleviz's default.
    least_area_m2 : float
        Parts of the patch smaller than this are left out.
    solver : str or None
        Solver of the inverse problem; None for bubbleviz's default.
    speed : float
        Playback speed, 1 = as recorded.
    every_frame : bool
        Playback waits for each frame, however slow; else it keeps time and leaves some out.
    loop : bool
        Begin again after the last frame, or the last of the looped range.
    layers, panels : frozenset of str
        What is visible.
    plots, images : frozenset of str
        What the panels of these names show.
    cloud_colour : {"residual", "patch", "plain"}
        What colours the measured points.
    cloud_points : int or None
        Points drawn at most: beyond that, every n-th measured point; None for all. Of 10,000
        on the dome each has some 4×4 screen pixels, so one sees both them and the membrane.
    membrane_opacity : float
        0 … 1.
    view_from : (float, float, float)
        Direction in B that a fresh view looks from, towards the middle of the membrane.
    zoom : float
        How near a fresh view is; 1 shows the whole box around the membrane.
    colour_map : str
        Of the contact pressure, one of `COLOUR_MAPS`.
    exaggeration : float
        Drawn displacement in true ones.
    section_axis : {"x", "y", "z"} or None
        Normal of the plane that cuts the scene open; None: it is whole.
    section_at_m : float
        Where the plane crosses its axis.
    section_flipped : bool
        The other side is drawn.
    pressure_max_pa, residual_max_m : float or None
        Upper ends of the colour ranges; None: the largest value seen, rounded up.
    pose_object : str or None
        Object to look for: preset or mesh file; None for none.
    pose_unit : {"m", "mm"} or None
        Of the mesh file; None: by its name.
    pose_start : tuple of 7 float or None
        T_B_O the search begins at, x y z in m and qx qy qz qw; None: all around.
    pose_track : bool
        Follow the object that is chosen in every frame.
    pose_stage : int
        Stage whose pose the object is drawn at; 2 for both.
    compared : (Setting, Setting)
        What is measured side by side.
    picture_size : (int, int)
        Width and height of pictures of the 3-D view, pixels.
    pre_roll_s : float
        How much of what came before the record button is recorded, too.
    record_folder : str or None
        Where recordings go; None: where the program was started.
    publish_at : str
        Where results are published once that is asked for.
    length_unit, pressure_unit, force_unit, duration_unit : str
        What numbers are shown in, see `units.SYSTEMS`.
    theme : {"system", "dark", "light"}
        Colours of the window.
    """

    kappa: float | None = None
    least_area_m2: float = 0.0
    solver: str | None = None
    speed: float = 1.0
    every_frame: bool = False
    loop: bool = True
    layers: frozenset[str] = frozenset(LAYERS) - {"wireframe", "frustum", "vectors"}
    panels: frozenset[str] = frozenset({"kappa_panel", "status"})
    plots: frozenset[str] = frozenset({"force", "gas", "area"})
    images: frozenset[ImageName] = frozenset({"depth", "change", "residual"})
    cloud_colour: CloudColour = "residual"
    cloud_points: int | None = 10_000
    membrane_opacity: float = 1.0
    view_from: tuple[float, float, float] = (-0.6, -1.0, 1.1)
    zoom: float = 1.32
    colour_map: ColourMap = "inferno"
    exaggeration: float = 1.0
    section_axis: Axis | None = None
    section_at_m: float = 0.0
    section_flipped: bool = False
    pressure_max_pa: float | None = None
    residual_max_m: float | None = None
    pose_object: str | None = None
    pose_unit: Literal["m", "mm"] | None = None
    pose_start: tuple[float, float, float, float, float, float, float] | None = None
    pose_track: bool = False
    pose_stage: int = 2
    compared: tuple[Setting, Setting] = (Setting(), Setting(recasts=0))
    picture_size: tuple[int, int] = (1920, 1080)
    pre_roll_s: float = PRE_ROLL_S
    record_folder: str | None = None
    publish_at: str = LOOPBACK
    length_unit: Literal["mm", "m"] = "mm"
    pressure_unit: Literal["kPa", "Pa", "psi"] = "kPa"
    force_unit: Literal["N", "mN"] = "N"
    duration_unit: Literal["ms", "s"] = "ms"
    theme: ThemeName = "system"

    @property
    def rule(self) -> Rule:
        """What makes a patch of a contact pressure: κ and the least area."""
        return self.kappa, self.least_area_m2


Rule = tuple[float | None, float]
