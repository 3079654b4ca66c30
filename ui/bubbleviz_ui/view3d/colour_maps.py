"""Colour maps of the 3-D view."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvista as pv
from matplotlib import colormaps

from bubbleviz_ui.shell import theme

ENTRIES = 256
NEUTRAL_ENTRIES = 5
"""Lowest entries of the pressure map that stay neutral: no contact is not a colour."""
BLEND_ENTRIES = 20
DARKEST = 0.28
"""Share of a map that is too dark to be told from the shadows of the membrane."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 … 255, of `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def pressure_colours(name: str) -> np.ndarray:
    """Entries (256, 4) uint8: neutral at zero, then a uniform map: brighter is stronger."""
    sampled = colormaps[name](np.linspace(DARKEST, 1.0, ENTRIES))
    values = np.asarray(sampled * 255.0).astype(np.uint8)
    neutral = np.array([*rgb(theme.NEUTRAL), 255], float)
    values[:NEUTRAL_ENTRIES] = neutral
    blend = slice(NEUTRAL_ENTRIES, NEUTRAL_ENTRIES + BLEND_ENTRIES)
    share = np.linspace(0.0, 1.0, BLEND_ENTRIES)[:, None]
    values[blend] = (1 - share) * neutral + share * values[blend]
    return values


def residual_colours(middle: str) -> np.ndarray:
    """Entries (256, 4) uint8: blue where measured nearer than modelled, green where farther.

    `middle` is between. Neither end is a colour of the pressure map, so the two are never mistaken
    for each other.
    """
    ends = (theme.NEARER, middle, theme.FARTHER)
    nearer, between, farther = (np.array([*rgb(colour), 255], float) for colour in ends)
    share = np.linspace(-1.0, 1.0, ENTRIES)[:, None]
    values = np.where(share < 0, nearer, farther) * abs(share) + between * (1.0 - abs(share))
    return values.astype(np.uint8)


def lookup_table(values: np.ndarray) -> Any:
    """Table of VTK with such entries (256, 4) uint8."""
    table = pv.LookupTable()
    table.values = values
    table.nan_color = theme.UNKNOWN
    return table
