"""What a person decides of an identification, and what is known after each of its steps."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bubbleviz.calibration.identification import Identification
    from bubbleviz.calibration.rest.contact_free import ContactFree
    from bubbleviz.calibration.rest.frame_ranges import Ranges
    from bubbleviz.calibration.rest.pixel_selection import PixelStatistics
    from bubbleviz.calibration.rest.rest_frames import Samples
    from bubbleviz.calibration.surface.reference_surface import Name, Surfaces
    from bubbleviz.calibration.tension.tension_estimate import TensionEstimate
    from bubbleviz.calibration.validation import KnownPress, Validation


class Step(IntEnum):
    """The steps in their order."""

    START = 0
    FRAMES = 1
    PIXELS = 2
    SURFACE = 3
    TENSION = 4


@dataclass(frozen=True)
class Settings:
    """What a person decides; the rest follows.

    Attributes
    ----------
    reached : Step
        The last step to do.
    ranges : tuple of (int, int) or None
        Contact-free frames, first and one after the last of each range; None: found.
    min_validity : float or None
        Share of the frames in which a pixel must have a return; None: nine tenths of the usual.
    deviations : float
        Robust standard deviations beyond which a pixel is too noisy, or too far off.
    surface : {"sphere", "ellipsoid", "free-form"} or None
        None: the data choose.
    nodes : int
        Target number of nodes of the mesh.
    levels : tuple of path
        Recordings of the untouched sensor at other inflation levels.
    vented : path or None
        Recording of the open chamber, for the atmospheric pressure.
    press : KnownPress or None
        What to validate by, in the same source.
    """

    reached: Step = Step.START
    ranges: Ranges | None = None
    min_validity: float | None = None
    deviations: float = 3.0
    surface: Name | None = None
    nodes: int = 1000
    levels: tuple[Path, ...] = ()
    vented: Path | None = None
    press: KnownPress | None = None


@dataclass(frozen=True)
class Draft:
    """What is known after the steps so far; None where a step was not reached.

    Attributes
    ----------
    settings : Settings
    ranges : tuple of (int, int)
        Contact-free frames in use.
    contact_free : ContactFree or None
        What was found, whether or not it is used.
    samples : Samples or None
    pixels : PixelStatistics or None
        Of the step SURFACE on less its bias; before, by validity and noise alone.
    surfaces : Surfaces or None
    tension : TensionEstimate or None
    found : Identification or None
        Rectified by the other levels, where there are.
    validation : Validation or None
    """

    settings: Settings
    ranges: Ranges = ()
    contact_free: ContactFree | None = None
    samples: Samples | None = None
    pixels: PixelStatistics | None = None
    surfaces: Surfaces | None = None
    tension: TensionEstimate | None = None
    found: Identification | None = None
    validation: Validation | None = None
