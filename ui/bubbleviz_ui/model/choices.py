"""What the user chose; it outlives new data. No Qt in here."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Literal, TypeVar

from bubbleviz.inverse import EstimatorOptions
from bubbleviz_ui.model.registry import ASKING, LAYERS

CloudColour = Literal["residual", "patch", "plain"]
Axis = Literal["x", "y", "z"]
ColourMap = Literal["inferno", "viridis", "cividis", "magma", "plasma"]
COLOUR_MAPS: tuple[ColourMap, ...] = ("inferno", "viridis", "cividis", "magma", "plasma")
"""All perceptually uniform (van der Walt and Smith 2015; Nuñez 2018)."""
ImageName = Literal["depth", "change", "residual", "noise", "used", "patch", "colour", "flow"]
ThemeName = Literal["system", "dark", "light"]

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Playback speeds to choose from."""
PRE_ROLL_S = 2.0
LOOPBACK = "tcp/127.0.0.1:7448"
"""Where results are published unless told otherwise: this computer only."""


T = TypeVar("T")


def _setting(default: T, words: str = "", *, of: str = "") -> T:
    """A field of the choices, what the Edit menu calls it, and the groups it belongs to."""
    made: T = field(default=default, metadata={"words": words, "of": frozenset(of.split())})
    return made


SETTINGS = ("A", "B")
"""What stands for the settings of Compare in place of a solver's name."""
FEWEST_NODES = 100


def solver_title(solver: str | None) -> str:
    """What the window calls a value of `Choices.solver`."""
    return f"setting {solver} of Compare" if solver in SETTINGS else solver or "default"


@dataclass(frozen=True)
class Setting:
    """A setting of estimator and patch to compare; None is bubbleviz's default."""

    solver: str | None = None
    pressure_scale: float | None = None  # Contact pressure expected, in gauge pressures
    # Of the mesh; None: the sensor's
    nodes: int | None = None
    block: int | None = None  # Side of the squares of pixels that are averaged
    kappa: float | None = None  # As in `Choices`; None: that of the window
    # Coefficient of friction μ to expect of contacts with the exact membrane; 0: none
    friction: float | None = None

    @property
    def options(self) -> EstimatorOptions:
        """What the estimator takes."""
        usual = EstimatorOptions.named(self.solver, self.friction)
        return replace(
            usual,
            nodes=None if self.nodes is None else max(self.nodes, FEWEST_NODES),
            pressure_scale=self.pressure_scale or usual.pressure_scale,
            block=self.block,
        )


@dataclass(frozen=True)
class Choices:
    """What the user chose; it outlives new data."""

    # Patch threshold, multiple of the mean contact pressure; None for bubbleviz's default
    kappa: float | None = _setting(None, "κ", of="patch")
    # Parts of the patch smaller than this are left out
    least_area_m2: float = _setting(0.0, of="patch")
    # Solver of the inverse problem, or A or B for a setting of Compare; None for the default
    solver: str | None = None
    speed: float = _setting(1.0, of="playback")  # Playback speed, 1 = as recorded
    # Playback waits for each frame, however slow; else it keeps time and leaves some out
    every_frame: bool = _setting(False, of="playback")
    # Begin again after the last frame, or the last of the looped range
    loop: bool = _setting(True, of="playback")
    # layers, panels: What is visible
    layers: frozenset[str] = frozenset(name for name, layer in LAYERS.items() if layer.at_first)
    panels: frozenset[str] = frozenset(name for name, panel in ASKING.items() if panel.at_first)
    # plots, images: What the panels of these names show
    plots: frozenset[str] = frozenset({"force", "gas", "area"})
    images: frozenset[ImageName] = frozenset({"depth", "change", "residual"})
    cloud_colour: CloudColour = "residual"  # What colours the measured points
    # Points drawn at most: beyond that, every n-th measured point; None for all. Of 10,000 on the
    # dome each has some 4×4 screen pixels, so one sees both them and the membrane
    cloud_points: int | None = 10_000
    membrane_opacity: float = 1.0  # 0 … 1
    # Direction in B that a fresh view looks from, towards the middle of the membrane
    view_from: tuple[float, float, float] = _setting((-0.6, -1.0, 1.1), "scene")
    zoom: float = 1.32  # How near a fresh view is; 1 shows the whole box around the membrane
    colour_map: ColourMap = "inferno"  # Of the contact pressure, one of `COLOUR_MAPS`
    exaggeration: float = 1.0  # Drawn displacement in true ones
    # Normal of the plane that cuts the scene open; None: it is whole
    section_axis: Axis | None = None
    section_at_m: float = 0.0  # Where the plane crosses its axis
    section_flipped: bool = False  # The other side is drawn
    # pressure_max_pa, residual_max_m: Upper ends of the colour ranges; None: by the frames seen,
    # see `HeldRanges`
    pressure_max_pa: float | None = _setting(None, "pressure range")
    residual_max_m: float | None = _setting(None, "residual range")
    # Object to look for: preset or mesh file; None for none
    pose_object: str | None = _setting(None, "object", of="pose")
    # Of the mesh file; None: by its name
    pose_unit: Literal["m", "mm"] | None = _setting(None, of="pose")
    # T_B_O the search begins at, x y z in m and qx qy qz qw; None: all around
    pose_start: tuple[float, float, float, float, float, float, float] | None = _setting(
        None, "start of the object"
    )
    pose_track: bool = False  # Follow the object that is chosen in every frame
    pose_stage: int = 2  # Stage whose pose the object is drawn at; 2 for both
    # Of the optical flow that shear is measured by
    flow_preset: Literal["fast", "balanced", "fine"] = _setting("fast", "flow preset")
    # Coulomb's bound μ of the tangential over the normal traction; None for no bound
    friction: float | None = _setting(None, "friction bound μ")
    # What is measured side by side
    compared: tuple[Setting, Setting] = _setting(
        (Setting(), Setting(solver="linear")), "compared settings"
    )
    # Width and height of pictures of the 3-D view, pixels
    picture_size: tuple[int, int] = (1920, 1080)
    # How much of what came before the record button is recorded, too
    pre_roll_s: float = _setting(PRE_ROLL_S, of="recording")
    # Where recordings go; None: a folder of their own in the user's
    record_folder: str | None = _setting(None, of="recording own")
    # Where results are published once that is asked for
    publish_at: str = _setting(LOOPBACK, of="recording own")
    # length_unit, pressure_unit, force_unit, duration_unit: What numbers are shown in, see
    # `units.SYSTEMS`
    length_unit: Literal["mm", "m"] = "mm"
    pressure_unit: Literal["kPa", "Pa", "psi"] = "kPa"
    force_unit: Literal["N", "mN"] = "N"
    duration_unit: Literal["ms", "s"] = "ms"
    # Colours of the window
    theme: Literal["system", "dark", "light"] = _setting("system", of="own")

    @property
    def options(self) -> EstimatorOptions:
        """What the estimator takes."""
        used = self.used
        return EstimatorOptions.named(self.solver) if used is None else used.options

    @property
    def used(self) -> Setting | None:
        """The setting of Compare that the whole window uses; None: neither."""
        return self.compared[SETTINGS.index(self.solver)] if self.solver in SETTINGS else None

    @property
    def rule(self) -> Rule:
        """What makes a patch of a contact pressure: κ and the least area."""
        return self.kappa, self.least_area_m2

    @staticmethod
    def group(name: str) -> frozenset[str]:
        """Fields of a group."""
        return frozenset(f.name for f in fields(Choices) if name in f.metadata.get("of", ()))

    @staticmethod
    def words(name: str) -> str:
        """What the Edit menu calls a field."""
        words: str = Choices.__dataclass_fields__[name].metadata.get("words", "")
        return words or name.replace("_", " ")


Rule = tuple[float | None, float]
PATCH_CHOICES = Choices.group("patch")
"""Choices that make another patch of the same contact pressure."""
POSE_CHOICES = Choices.group("pose")
"""Choices that make it another object."""
PLAYBACK_CHOICES = Choices.group("playback")
RECORDING_CHOICES = Choices.group("recording")
OWN_CHOICES = Choices.group("own")
"""Choices that are the user's and of this computer; they neither come nor go with a session."""
