"""How well the 3-D view is drawn, by what draws it: a GPU, or the processor that also solves."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from typing import Any

from PySide6.QtGui import QOffscreenSurface, QOpenGLContext

from bubbleviz.errors import InputError

VARIABLE = "BUBBLEVIZ_RENDERING"
"""Environment variable that chooses in place of the renderer."""
SAMPLES = 4
"""Samples a pixel, which every GPU has."""

_SOFTWARE = re.compile(
    r"\b(llvmpipe|softpipe|swrast|swr|software|mesa offscreen|gdi generic|basic render)\b",
    re.IGNORECASE,
)
_GL_RENDERER = 0x1F01
_BRIGHT = {"ambient": 0.5, "diffuse": 0.6, "specular": 0.0}
"""Of balls: their colour means something, so it is not shaded far."""


@dataclass(frozen=True)
class RenderQuality:
    """What the 3-D view spends on a picture.

    Attributes
    ----------
    name : str
        What `BUBBLEVIZ_RENDERING` calls it.
    samples : int
        Samples a pixel, for smooth edges; 0 for none.
    round_points : bool
        Points are shaded balls instead of flat squares.
    thinned : int
        One in so many points of the cloud is drawn while frames follow each other.
    own_swap : bool
        The view puts its pictures on the screen itself, see `direct_swap`; else Qt does.
    renderer : str
        What the driver calls itself; empty where it was not asked.
    """

    name: str
    samples: int
    round_points: bool
    thinned: int
    own_swap: bool
    renderer: str = ""

    @property
    def points(self) -> dict[str, Any]:
        """How points look, as `View.add_mesh` takes it."""
        balls = self.round_points
        looks = {"style": "points", "render_points_as_spheres": balls, "lighting": balls}
        return looks | (_BRIGHT if balls else {})

    @property
    def text(self) -> str:
        """The quality, and what draws."""
        return f"{self.name}, by {self.renderer}" if self.renderer else self.name


FAST = RenderQuality("fast", samples=0, round_points=False, thinned=4, own_swap=True)
SMOOTH = RenderQuality("smooth", samples=SAMPLES, round_points=True, thinned=1, own_swap=False)


def quality_for(renderer: str, wanted: str = "") -> RenderQuality:
    """Fast for software or an unknown renderer, smooth for any other, unless one is wanted.

    Parameters
    ----------
    renderer : str
        OpenGL's name of it.
    wanted : str
        Name of a quality; empty for the renderer's.

    Raises
    ------
    InputError
        There is no such quality.
    """
    known = {quality.name: quality for quality in (FAST, SMOOTH)}
    if wanted and wanted not in known:
        raise InputError(
            f"{VARIABLE} is {wanted!r}; set it to {' or '.join(known)}, or leave it unset"
        )
    by_renderer = SMOOTH if renderer and not _SOFTWARE.search(renderer) else FAST
    return replace(known.get(wanted, by_renderer), renderer=renderer)


def quality_here() -> RenderQuality:
    """The quality for this machine's renderer, or the one `BUBBLEVIZ_RENDERING` names.

    Raises
    ------
    InputError
        The variable names none.
    """
    return quality_for(renderer_name(), os.environ.get(VARIABLE, ""))


def renderer_name() -> str:
    """What OpenGL's driver calls itself; empty without OpenGL. The Qt application exists."""
    surface, context = QOffscreenSurface(), QOpenGLContext()
    surface.create()
    if not (context.create() and context.makeCurrent(surface)):
        return ""
    name = context.functions().glGetString(_GL_RENDERER)
    context.doneCurrent()
    return str(name or "")
