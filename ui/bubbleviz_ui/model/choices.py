"""What the user chose; it outlives new data. No Qt in here.

Each setting says how it is called, which values it has and what its control shows: forms, menus,
undo and session files go by that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, TypeVar

from bubbleviz.inverse import ESTIMATORS, MAX_NODES, SOLVER_NAMES, EstimatorOptions
from bubbleviz.membrane import MOST_FRICTION
from bubbleviz_ui.model.registry import ASKING, IMAGES, LAYERS, PLOTS
from bubbleviz_ui.model.units import PLAIN, SYSTEMS, Unit

CloudColour = Literal["residual", "patch", "plain"]
Axis = Literal["x", "y", "z"]
ColourMap = Literal["inferno", "viridis", "cividis", "magma", "plasma"]
"""All perceptually uniform (van der Walt and Smith 2015; Nuñez 2018)."""
ImageName = Literal["depth", "change", "residual", "noise", "used", "patch", "colour", "flow"]
ThemeName = Literal["system", "dark", "light"]

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Playback speeds to choose from."""
LOOPBACK = "tcp/127.0.0.1:7448"
"""Where results are published unless told otherwise: this computer only."""
SETTINGS = ("A", "B")
"""What stands for the settings of Compare in place of a solver's name."""
FEWEST_NODES = 100


@dataclass(frozen=True)
class About:
    """How a setting is named, shown and edited."""

    label: str  # Beside its control and in the Edit menu
    tip: str = ""
    titles: Mapping[Any, str] | None = None  # Of its values, or of what may be in it, if few
    others: bool = False  # Values without a title are possible, too
    # low, high, step: Of a number, SI; whole numbers have whole ends
    low: float = 0.0
    high: float = 0.0
    step: float = 1.0
    unit: str | Unit = PLAIN  # Of a number: one of `Units` by name, or its own
    slider: bool = False  # It is edited with a slider, not with a box
    lowest: str = ""  # Text in place of the lowest number
    usual: float | None = None  # Number that stands for None; the lowest where not given
    of: frozenset[str] = frozenset()  # Groups it belongs to

    def known(self, value: Any, default: Any) -> Any:
        """The value of a file, as far as there is such a value; else the default."""
        if self.titles is None or self.others:
            return value
        if isinstance(value, frozenset):
            return value & frozenset(self.titles)
        return value if value in self.titles else default


T = TypeVar("T")


def _setting(default: T, label: str, tip: str = "", *, of: str = "", **how: Any) -> T:
    """A setting with its default, and how it is shown, see `About`."""
    about = About(label, tip, of=frozenset(of.split()), **how)
    made: T = field(default=default, metadata={"about": about})
    return made


class _Described:
    """Dataclass whose fields are settings."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @classmethod
    def about(cls, name: str) -> About:
        """How a setting is shown."""
        about: About = cls.__dataclass_fields__[name].metadata["about"]
        return about

    @classmethod
    def known(cls, name: str, value: Any) -> Any:
        """A value as far as this version knows it, see `About.known`."""
        return cls.about(name).known(value, cls.__dataclass_fields__[name].default)


def solver_title(solver: str | None) -> str:
    """What the window calls a value of `Choices.solver`."""
    if solver in SETTINGS:
        return f"setting {solver} of Compare"
    name, _, base = (solver or "default").partition("-")
    return f"{name}, sensor's mesh alone" if base else name


def _same(*names: str) -> dict[str, str]:
    """Titles of values that are their own."""
    return {name: name for name in names}


KAPPA = "κ: threshold as a multiple of the mean contact pressure (section V-C of the paper)"
TIMES, PIXELS, SECONDS = Unit("×", 1.0, 2), Unit("px", 1.0, 0), Unit("s", 1.0, 1)
USUAL = EstimatorOptions()


@dataclass(frozen=True)
class Setting(_Described):
    """A setting of estimator and patch to compare; None is bubbleviz's default."""

    solver: str | None = _setting(
        None,
        "Solver",
        "Solver of the inverse problem; rubber: exact membrane",
        titles={name: solver_title(name) for name in (None, *ESTIMATORS)},
    )
    pressure_scale: float | None = _setting(
        None,
        "Pressure prior",
        "Expected contact pressure, in gauge pressures; larger: less smoothing",
        low=0.1, high=100.0, step=0.5, unit=TIMES, usual=USUAL.pressure_scale,
    )  # fmt: skip
    friction: float | None = _setting(
        None,
        "Friction μ",
        "Expected coefficient of friction; lowest value: no friction. Only the exact membrane"
        " (rubber) has friction",
        high=MOST_FRICTION, step=0.1, lowest="none", usual=USUAL.friction,
    )  # fmt: skip
    nodes: int | None = _setting(
        None,
        "Nodes",
        "Number of mesh nodes; ignored if the sensor has a mesh file",
        low=0, high=min(5_000, MAX_NODES), step=100, lowest="sensor's",
    )  # fmt: skip
    block: int | None = _setting(
        None,
        "Pixel binning",
        "Side of the squares of pixels that are averaged",
        low=0, high=16, unit=PIXELS, lowest="automatic",
    )  # fmt: skip
    kappa: float | None = _setting(None, "κ", KAPPA, high=100.0, step=0.5, lowest="as shown")

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
class Choices(_Described):
    """What the user chose; it outlives new data."""

    # None for bubbleviz's own rule in place of the multiple
    kappa: float | None = _setting(None, "κ", KAPPA, of="patch", low=0.1, high=100.0)
    least_area_m2: float = _setting(
        0.0,
        "Remove parts below",
        "Parts of the patch smaller than this are not contact",
        of="patch", high=0.01, step=5e-6, unit="area", lowest="nothing",  # m²: any bubble; 5 mm²
    )  # fmt: skip
    # Solver of the inverse problem, or A or B for a setting of Compare; None for the default
    solver: str | None = _setting(
        None,
        "Solver",
        "Solver of the inverse problem (Eq. 23); a change solves the frame again",
        titles={name: solver_title(name) for name in (None, *SOLVER_NAMES, *SETTINGS)},
    )
    speed: float = _setting(
        1.0,
        "Speed",
        "Playback speed (Ctrl+↑, Ctrl+↓)",
        of="playback",
        titles={speed: f"{speed:g}×" for speed in SPEEDS},
    )
    every_frame: bool = _setting(
        False,
        "Playback",
        "Real time: skip frames if needed; every frame: show all, however slowly (E)",
        of="playback",
        titles={False: "real time", True: "every frame"},
    )
    loop: bool = _setting(
        True, "Loop", "Repeat the recording or the chosen range (L)", of="playback"
    )
    # layers, panels: What is visible
    layers: frozenset[str] = _setting(
        frozenset(name for name, layer in LAYERS.items() if layer.at_first),
        "layers",
        titles={name: layer.title for name, layer in LAYERS.items()},
    )
    panels: frozenset[str] = _setting(
        frozenset(name for name, panel in ASKING.items() if panel.at_first),
        "panels",
        titles={name: panel.title for name, panel in ASKING.items()},
    )
    # plots, images: What the panels of these names show
    plots: frozenset[str] = _setting(
        frozenset({"force", "gas", "area"}),
        "Plots",
        "Quantities to plot; others are not computed",
        titles={name: plot.title for name, plot in PLOTS.items()},
    )
    images: frozenset[ImageName] = _setting(
        frozenset[ImageName]({"depth", "change", "residual"}),
        "Images",
        "Images to show; others are not computed",
        titles=IMAGES,
    )
    cloud_colour: CloudColour = _setting(
        "residual",
        "Colour points by",
        "Residual: measured minus modelled range; patch: whether in contact",
        titles={"residual": "residual", "patch": "patch", "plain": "one colour"},
    )
    # Points drawn at most: beyond that, every n-th measured point; None for all. Of 10,000 on the
    # dome each has some 4×4 screen pixels, so one sees both them and the membrane
    cloud_points: int | None = _setting(
        10_000,
        "Points shown",
        "Most points drawn; the solver always uses all. Without a GPU, playback draws a quarter",
        titles={
            **{n: f"up to {n:,}".replace(",", " ") for n in (5_000, 10_000, 20_000, 50_000)},
            None: "all",
        },
        others=True,
    )
    membrane_opacity: float = _setting(
        1.0,
        "Opacity",
        "Opacity of the membrane, 10 … 100 %",
        low=0.1, high=1.0, step=0.01, slider=True,
    )  # fmt: skip
    # Direction in B that a fresh view looks from, towards the middle of the membrane
    view_from: tuple[float, float, float] = _setting((-0.6, -1.0, 1.1), "scene")
    zoom: float = _setting(1.32, "scene")  # How near; 1 shows the whole box around the membrane
    colour_map: ColourMap = _setting(
        "inferno",
        "Colours",
        "Colours of the contact pressure, perceptually uniform",
        titles=_same("inferno", "viridis", "cividis", "magma", "plasma"),
    )
    exaggeration: float = _setting(
        1.0,
        "Exaggerate",
        "Factor by which displacement u is exaggerated",
        high=10.0, step=0.5, unit=TIMES,
    )  # fmt: skip
    # Normal of the plane that cuts the scene open; None: it is whole
    section_axis: Axis | None = _setting(
        None,
        "Section",
        "Cut the membrane across an axis of the bubble frame B",
        titles={None: "whole", "x": "cut ⊥ x", "y": "cut ⊥ y", "z": "cut ⊥ z"},
    )
    section_at_m: float = _setting(0.0, "Position of the section", "Position of the cutting plane")
    section_flipped: bool = _setting(
        False, "other side", "Show what is on the other side of the plane"
    )
    # pressure_max_pa, residual_max_m: Upper ends of the colour ranges; None: by the frames seen,
    # see `HeldRanges`
    pressure_max_pa: float | None = _setting(
        None,
        "Maximum pressure",
        "Pressure at the top of the colour scale; lowest value: automatic",
        high=1e6, step=1e3, unit="pressure", lowest="automatic",
    )  # fmt: skip
    residual_max_m: float | None = _setting(
        None,
        "Maximum residual ±",
        "Residual at the ends of the colour scale; lowest value: automatic",
        high=0.1, step=1e-4, unit="length", lowest="automatic",
    )  # fmt: skip
    # Object to look for: preset or mesh file; None for none
    pose_object: str | None = _setting(None, "object", of="pose")
    # Of the mesh file; None: by its name
    pose_unit: Literal["m", "mm"] | None = _setting(
        None,
        "unit of the object",
        "Unit of a mesh file; by name: mm where it ends in _mm, else m",
        of="pose",
        titles={None: "unit by name", "m": "metres", "mm": "millimetres"},
    )
    # T_B_O the search begins at, x y z in m and qx qy qz qw; None: all around
    pose_start: tuple[float, float, float, float, float, float, float] | None = _setting(
        None, "initial pose"
    )
    pose_track: bool = _setting(False, "tracking", "Follow the object from frame to frame")
    # Stage whose pose the object is drawn at; 2 for both
    pose_stage: int = _setting(
        2, "Shown", "Stage whose pose is drawn", titles={2: "both stages", 1: "stage one"}
    )
    # Of the optical flow that shear is measured by
    flow_preset: Literal["fast", "balanced", "fine"] = _setting(
        "fast",
        "Optical flow",
        "Optical flow: fast, or more accurate",
        titles=_same("fast", "balanced", "fine"),
    )
    # Coulomb's bound μ of the tangential over the normal traction; None for no bound
    friction: float | None = _setting(
        None,
        "Friction bound",
        "Limit the tangential traction to μ times the normal one (Coulomb)",
        low=0.01, high=MOST_FRICTION, step=0.05,
    )  # fmt: skip
    # What is measured side by side
    compared: tuple[Setting, Setting] = _setting(
        (Setting(), Setting(solver="linear")), "compared settings"
    )
    # Width and height of pictures of the 3-D view, pixels
    picture_size: tuple[int, int] = _setting((1920, 1080), "Picture", "Pixels", low=16, high=8192)
    # At most 60 s are kept in memory: 1.1 GB of 16-bit 640×480 at 30 Hz
    pre_roll_s: float = _setting(
        2.0,
        "Include the previous",
        "Also record this much from before the button was pressed",
        of="recording", high=60.0, unit=SECONDS,
    )  # fmt: skip
    # Where recordings go; None: a folder of their own in the user's
    record_folder: str | None = _setting(None, "record folder", of="recording own")
    # Where results are published once that is asked for
    publish_at: str = _setting(LOOPBACK, "place to publish at", of="recording own")
    # length_unit, pressure_unit, force_unit, duration_unit: What numbers are shown in, see
    # `units.SYSTEMS`
    length_unit: Literal["mm", "m"] = _setting(
        "mm", "unit of length", titles=_same(*SYSTEMS["length_unit"])
    )
    pressure_unit: Literal["kPa", "Pa", "psi"] = _setting(
        "kPa", "unit of pressure", titles=_same(*SYSTEMS["pressure_unit"])
    )
    force_unit: Literal["N", "mN"] = _setting(
        "N", "unit of force", titles=_same(*SYSTEMS["force_unit"])
    )
    duration_unit: Literal["ms", "s"] = _setting(
        "ms", "unit of duration", titles=_same(*SYSTEMS["duration_unit"])
    )
    # Colours of the window
    theme: ThemeName = _setting(
        "system",
        "theme",
        of="own",
        titles={"system": "As the &system", "dark": "&Dark", "light": "&Light"},
    )

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
        return frozenset(f.name for f in fields(Choices) if name in Choices.about(f.name).of)


Rule = tuple[float | None, float]
PATCH_CHOICES = Choices.group("patch")
"""Choices that make another patch of the same contact pressure."""
POSE_CHOICES = Choices.group("pose")
"""Choices that make it another object."""
PLAYBACK_CHOICES = Choices.group("playback")
RECORDING_CHOICES = Choices.group("recording")
OWN_CHOICES = Choices.group("own")
"""Choices that are the user's and of this computer; they neither come nor go with a session."""
