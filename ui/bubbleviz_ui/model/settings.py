"""Settings of the window, kept when another source is opened. No Qt.

Each setting declares its label, values and control; forms, menus, undo and session files use that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, TypeVar, get_args

from pydantic import TypeAdapter

from bubbleviz.inverse import ESTIMATORS, MAX_NODES, SOLVER_NAMES, EstimatorOptions
from bubbleviz.membrane import MOST_FRICTION
from bubbleviz_ui.model.registry import IMAGES, LAYERS, PANELS, PLOTS
from bubbleviz_ui.model.units import DIMENSIONLESS, UNIT_CHOICES, Unit

CloudColour = Literal["residual", "patch", "plain"]
Axis = Literal["x", "y", "z"]
ColourMap = Literal["inferno", "viridis", "cividis", "magma", "plasma"]
"""Perceptually uniform (van der Walt and Smith 2015; Nuñez 2018)."""
ThemeName = Literal["system", "dark", "light"]

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Playback speeds offered."""
LOOPBACK = "tcp/127.0.0.1:7448"
"""Default endpoint for publishing results: this computer only."""
COMPARED_NAMES = ("A", "B")
"""Values of `Settings.solver` that select a setting of the Compare panel."""
FEWEST_NODES = 100


@dataclass(frozen=True)
class SettingInfo:
    """Label, values and control of a setting."""

    label: str  # Next to its control and in the Edit menu
    tip: str = ""
    titles: Mapping[Any, str] | None = None  # Title of each value, or of each element of a set
    open_ended: bool = False  # Values without a title are valid too
    # low, high, step: Of a number, SI; integers for an integer setting
    low: float = 0.0
    high: float = 0.0
    step: float = 1.0
    unit: str | Unit = DIMENSIONLESS  # Name of an attribute of `Units`, or a unit
    slider: bool = False  # Edited with a slider instead of a number box
    lowest: str = ""  # Text shown in place of the lowest number
    number_for_none: float | None = None  # Number shown for None; by default the lowest
    groups: frozenset[str] = frozenset()

    def valid(self, value: Any, default: Any) -> Any:
        """The value read from a file if this version knows it, else the default."""
        if self.titles is None or self.open_ended:
            return value
        if isinstance(value, frozenset):
            return value & frozenset(self.titles)
        return value if value in self.titles else default


T = TypeVar("T")


def _setting(default: T, label: str, tip: str = "", *, groups: str = "", **how: Any) -> T:
    """Dataclass field with a default and a `SettingInfo`."""
    info = SettingInfo(label, tip, groups=frozenset(groups.split()), **how)
    made: T = field(default=default, metadata={"info": info})
    return made


class _SettingsBase:
    """Base of dataclasses whose fields are settings."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @classmethod
    def info(cls, name: str) -> SettingInfo:
        """Label, values and control of a setting."""
        info: SettingInfo = cls.__dataclass_fields__[name].metadata["info"]
        return info

    @classmethod
    def valid(cls, name: str, value: Any) -> Any:
        """The value if this version knows it, else the default."""
        return cls.info(name).valid(value, cls.__dataclass_fields__[name].default)


def solver_title(solver: str | None) -> str:
    """Title of a value of `Settings.solver`."""
    if solver in COMPARED_NAMES:
        return f"setting {solver} of Compare"
    name, _, base = (solver or "default").partition("-")
    return f"{name}, sensor's mesh alone" if base else name


def _own_titles(*names: str) -> dict[str, str]:
    return {name: name for name in names}


KAPPA = (
    "κ: threshold as a multiple of the mean contact pressure over the membrane (section V-C of the "
    "paper)"
)
TIMES, PIXELS, SECONDS = Unit("×", 1.0, 2), Unit("px", 1.0, 0), Unit("s", 1.0, 1)
DEFAULT_OPTIONS = EstimatorOptions()


@dataclass(frozen=True)
class ComparedSetting(_SettingsBase):
    """Estimator and patch options to compare; None stands for the default."""

    solver: str | None = _setting(
        None,
        "Solver",
        "Solver of the inverse problem; rubber: exact membrane, linear: constant tension",
        titles={name: solver_title(name) for name in (None, *ESTIMATORS)},
    )
    pressure_scale: float | None = _setting(
        None,
        "Pressure prior",
        "Expected contact pressure as a multiple of the gauge pressure; larger: less smoothing",
        low=0.1, high=100.0, step=0.5, unit=TIMES, number_for_none=DEFAULT_OPTIONS.pressure_scale,
    )  # fmt: skip
    friction: float | None = _setting(
        None,
        "Friction μ",
        "Expected coefficient of friction; lowest value: no friction. Only the exact membrane"
        " (rubber) has friction",
        high=MOST_FRICTION, step=0.1, lowest="none", number_for_none=DEFAULT_OPTIONS.friction,
    )  # fmt: skip
    nodes: int | None = _setting(
        None,
        "Nodes",
        f"Number of mesh nodes, at least {FEWEST_NODES}; ignored if the sensor has a mesh file",
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
        base = EstimatorOptions.named(self.solver, self.friction)
        return replace(
            base,
            nodes=None if self.nodes is None else max(self.nodes, FEWEST_NODES),
            pressure_scale=self.pressure_scale or base.pressure_scale,
            block=self.block,
        )


@dataclass(frozen=True)
class Settings(_SettingsBase):
    """All settings of the window; kept when another source is opened."""

    # None: bubbleviz's own threshold rule instead of a multiple of the mean
    kappa: float | None = _setting(None, "κ", KAPPA, groups="patch", low=0.1, high=100.0)
    least_area_m2: float = _setting(
        0.0,
        "Remove parts below",
        "Smaller parts are removed from the patch; the force stays that of all parts",
        groups="patch", high=0.01, step=5e-6, unit="area", lowest="nothing",
    )  # fmt: skip
    # Solver of the inverse problem, or A or B for a setting of Compare; None: default solver
    solver: str | None = _setting(
        None,
        "Solver",
        "Solver of the inverse problem (Eq. 23); rubber: exact membrane, linear: constant tension, "
        "paper: the same by the paper's QP, fast: linear on a coarse mesh. A change discards the "
        "results of all frames",
        titles={name: solver_title(name) for name in (None, *SOLVER_NAMES, *COMPARED_NAMES)},
    )
    speed: float = _setting(
        1.0,
        "Speed",
        "Playback speed (Ctrl+↑, Ctrl+↓)",
        groups="playback",
        titles={speed: f"{speed:g}×" for speed in SPEEDS},
    )
    every_frame: bool = _setting(
        False,
        "Playback",
        "Real time: skip frames if needed; every frame: show all, however slowly (E)",
        groups="playback",
        titles={False: "real time", True: "every frame"},
    )
    loop: bool = _setting(
        True, "Loop", "Repeat the recording or the chosen range (L)", groups="playback"
    )
    # layers, panels: Names of the visible ones
    layers: frozenset[str] = _setting(
        frozenset(name for name, layer in LAYERS.items() if layer.by_default),
        "layers",
        groups="scene",
        titles={name: layer.title for name, layer in LAYERS.items()},
    )
    panels: frozenset[str] = _setting(
        frozenset(name for name, panel in PANELS.items() if panel.by_default),
        "panels",
        groups="scene",
        titles={name: panel.title for name, panel in PANELS.items()},
    )
    # plots, images: Shown in the panels of these names
    plots: frozenset[str] = _setting(
        frozenset({"force", "gas", "area"}),
        "Plots",
        "Quantities to plot; hidden ones are not computed",
        titles={name: plot.title for name, plot in PLOTS.items()},
    )
    images: frozenset[str] = _setting(
        frozenset({"depth", "change", "residual"}),
        "Images",
        "Images to show; others are not computed",
        titles={name: image.title for name, image in IMAGES.items()},
    )
    cloud_colour: CloudColour = _setting(
        "residual",
        "Colour points by",
        "Residual: measured minus modelled range; patch: whether in contact",
        groups="scene",
        titles={"residual": "residual", "patch": "patch", "plain": "one colour"},
    )
    # Most points drawn: beyond that, every n-th measured point; None: all. At 10,000 each point
    # has about 4×4 screen pixels, so that the membrane shows between them
    cloud_points: int | None = _setting(
        10_000,
        "Points shown",
        "Largest number of points drawn; the solver uses all. Without a GPU, playback draws a "
        "quarter",
        groups="scene",
        titles={
            **{n: f"up to {n:,}".replace(",", " ") for n in (5_000, 10_000, 20_000, 50_000)},
            None: "all",
        },
        open_ended=True,
    )
    membrane_opacity: float = _setting(
        1.0,
        "Opacity",
        "Opacity of the membrane, 10 … 100 %",
        groups="scene", low=0.1, high=1.0, step=0.01, slider=True,
    )  # fmt: skip
    # Direction in B from the middle of the membrane to the initial viewpoint
    view_from: tuple[float, float, float] = _setting((-0.6, -1.0, 1.1), "scene", groups="scene")
    # 1: bounding box of the membrane fills the view
    zoom: float = _setting(1.32, "scene", groups="scene")
    colour_map: ColourMap = _setting(
        "inferno",
        "Colours",
        "Colours of the contact pressure, perceptually uniform",
        titles=_own_titles(*get_args(ColourMap)),
    )
    exaggeration: float = _setting(
        1.0,
        "Exaggerate",
        "Factor by which displacement u is exaggerated",
        high=10.0, step=0.5, unit=TIMES,
    )  # fmt: skip
    # Normal of the section plane; None: no section
    section_axis: Axis | None = _setting(
        None,
        "Section",
        "Cut the membrane across an axis of the bubble frame B",
        titles={None: "none", "x": "cut ⊥ x", "y": "cut ⊥ y", "z": "cut ⊥ z"},
    )
    section_at_m: float = _setting(
        0.0, "Position of the section", "Position of the cutting plane along the axis chosen above"
    )
    section_flipped: bool = _setting(
        False, "other side", "Show the part on the other side of the plane"
    )
    # pressure_max_pa, residual_max_m: Upper ends of the colour scales; None: from all frames
    # computed so far, see `Scales`
    pressure_max_pa: float | None = _setting(
        None,
        "Maximum pressure",
        "Pressure at the top of the colour scale, which a click on its bar locks; lowest value: "
        "automatic",
        high=1e6, step=1e3, unit="pressure", lowest="automatic",
    )  # fmt: skip
    residual_max_m: float | None = _setting(
        None,
        "Maximum residual ±",
        "Residual at the ends of the colour scale, in the view and in the images; lowest value: "
        "automatic",
        high=0.1, step=1e-4, unit="length", lowest="automatic",
    )  # fmt: skip
    # Object to register: preset or mesh file; None: no object
    pose_object: str | None = _setting(None, "object", groups="pose")
    # Unit of the mesh file; None: from its name
    pose_unit: Literal["m", "mm"] | None = _setting(
        None,
        "unit of the object",
        "Unit of a mesh file; by name: mm if the file name ends in _mm, else m",
        groups="pose",
        titles={None: "unit by name", "m": "metres", "mm": "millimetres"},
    )
    # Initial pose T_B_O, x y z in m and qx qy qz qw; None: global search
    pose_start: tuple[float, float, float, float, float, float, float] | None = _setting(
        None, "initial pose"
    )
    pose_track: bool = _setting(False, "tracking", "Follow the object from frame to frame")
    # Registration stage whose pose is drawn; 2: after both
    pose_stage: int = _setting(
        2,
        "Shown",
        "Pose to draw: after both stages of the registration, or after stage one",
        titles={2: "both stages", 1: "stage one"},
    )
    # Settings A and B of the Compare panel
    compared: tuple[ComparedSetting, ComparedSetting] = _setting(
        (ComparedSetting(), ComparedSetting(solver="linear")), "compared settings"
    )
    # Width and height of screenshots of the 3-D view, pixels
    picture_size: tuple[int, int] = _setting(
        (1920, 1080),
        "Picture",
        "Width × height of pictures and videos of the 3-D view, pixels",
        low=16, high=8192,
    )  # fmt: skip
    # Limit of 60 s: 1.1 GB of memory for 16-bit 640×480 at 30 Hz
    pre_roll_s: float = _setting(
        2.0,
        "Include the previous",
        "Also record this much from before the button was pressed",
        groups="recording", high=60.0, unit=SECONDS,
    )  # fmt: skip
    # Folder for recordings; None: a folder of bubbleviz in the user's home
    record_folder: str | None = _setting(None, "record folder", groups="recording user")
    # Endpoint at which results are published
    publish_at: str = _setting(LOOPBACK, "publishing endpoint", groups="recording user")
    # length_unit, pressure_unit, force_unit, duration_unit: Units shown, see `units.UNIT_CHOICES`
    length_unit: Literal["mm", "m"] = _setting(
        "mm", "unit of length", titles=_own_titles(*UNIT_CHOICES["length_unit"])
    )
    pressure_unit: Literal["kPa", "Pa", "psi"] = _setting(
        "kPa", "unit of pressure", titles=_own_titles(*UNIT_CHOICES["pressure_unit"])
    )
    force_unit: Literal["N", "mN"] = _setting(
        "N", "unit of force", titles=_own_titles(*UNIT_CHOICES["force_unit"])
    )
    duration_unit: Literal["ms", "s"] = _setting(
        "ms", "unit of duration", titles=_own_titles(*UNIT_CHOICES["duration_unit"])
    )
    # Colours of the window
    theme: ThemeName = _setting(
        "system",
        "theme",
        groups="user",
        titles={"system": "As the &system", "dark": "&Dark", "light": "&Light"},
    )

    @property
    def options(self) -> EstimatorOptions:
        in_use = self.compared_in_use
        return EstimatorOptions.named(self.solver) if in_use is None else in_use.options

    @property
    def compared_in_use(self) -> ComparedSetting | None:
        """The setting of Compare that the window uses; None: neither A nor B."""
        return (
            self.compared[COMPARED_NAMES.index(self.solver)]
            if self.solver in COMPARED_NAMES
            else None
        )

    @property
    def patch_rule(self) -> PatchRule:
        """Parameters of the patch threshold: κ and the smallest area."""
        return self.kappa, self.least_area_m2

    @staticmethod
    def group(name: str) -> frozenset[str]:
        """Names of the fields of a group."""
        return frozenset(f.name for f in fields(Settings) if name in Settings.info(f.name).groups)


SETTINGS = TypeAdapter(Settings)
"""Checks settings read from a file, and writes them."""
PatchRule = tuple[float | None, float]
PATCH_SETTINGS = Settings.group("patch")
"""Settings that change the patch but not the contact pressure."""
POSE_SETTINGS = Settings.group("pose")
"""Settings of the registered object."""
PLAYBACK_SETTINGS = Settings.group("playback")
RECORDING_SETTINGS = Settings.group("recording")
USER_SETTINGS = Settings.group("user")
"""Settings of the user on this computer; not part of exchanged session files."""
