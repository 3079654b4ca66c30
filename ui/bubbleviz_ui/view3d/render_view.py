"""The 3-D view: a VTK render window in Qt that merges redraw requests."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from PySide6.QtCore import QCoreApplication, QEvent, QObject, QPointF, Qt, Signal
from PySide6.QtGui import (
    QDragEnterEvent,
    QDropEvent,
    QGuiApplication,
    QKeyEvent,
    QMouseEvent,
    QOffscreenSurface,
    QOpenGLContext,
    QPaintEvent,
    QResizeEvent,
    QShowEvent,
    QWindow,
)
from PySide6.QtWidgets import QWidget
from pyvistaqt import QtInteractor

from bubbleviz.errors import InputError
from bubbleviz_ui.model.throttle import RateMeter, Throttle
from bubbleviz_ui.shell import theme

# Render quality, depending on the renderer: a GPU, or the CPU that also solves.


VARIABLE = "BUBBLEVIZ_RENDERING"
"""Environment variable that overrides the choice of the quality."""
SAMPLES = 4
"""Samples per pixel, supported by every GPU."""

_SOFTWARE = re.compile(
    r"\b(llvmpipe|softpipe|swrast|swr|software|mesa offscreen|gdi generic|basic render)\b",
    re.IGNORECASE,
)
_GL_RENDERER = 0x1F01
_BRIGHT = {"ambient": 0.5, "diffuse": 0.6, "specular": 0.0}
"""Little shading of spheres, as their colour encodes a value."""


@dataclass(frozen=True)
class RenderQuality:
    """Render quality of the 3-D view."""

    name: str  # Value of `BUBBLEVIZ_RENDERING`
    samples: int  # Multisampling per pixel; 0: off
    round_points: bool  # Points are shaded spheres instead of flat squares
    cloud_decimation: int  # While playing, every n-th point of the cloud is drawn
    own_swap: bool  # The view swaps its own buffers, see `View._draw`, instead of Qt
    renderer: str = ""  # OpenGL name of the renderer; empty if unknown

    @property
    def points(self) -> dict[str, Any]:
        """Arguments of `new_actor` for points."""
        balls = self.round_points
        arguments = {"style": "points", "render_points_as_spheres": balls, "lighting": balls}
        return arguments | (_BRIGHT if balls else {})

    @property
    def text(self) -> str:
        return f"{self.name}, by {self.renderer}" if self.renderer else self.name


FAST = RenderQuality("fast", samples=0, round_points=False, cloud_decimation=4, own_swap=True)
SMOOTH = RenderQuality(
    "smooth", samples=SAMPLES, round_points=True, cloud_decimation=1, own_swap=False
)


def quality_for(renderer: str, wanted: str = "") -> RenderQuality:
    """Fast for a software or unknown renderer, smooth for any other, unless `wanted` is given.

    Raises InputError: There is no such quality.

    `renderer`: OpenGL name of the renderer.
    `wanted`: Name of a quality, or empty.
    """
    known = {quality.name: quality for quality in (FAST, SMOOTH)}
    if wanted and wanted not in known:
        raise InputError(
            f"{VARIABLE} is {wanted!r}; set it to {' or '.join(known)}, or leave it unset"
        )
    by_renderer = SMOOTH if renderer and not _SOFTWARE.search(renderer) else FAST
    return replace(known.get(wanted, by_renderer), renderer=renderer)


def detect_quality() -> RenderQuality:
    """Quality for this machine's renderer, or the one set by `BUBBLEVIZ_RENDERING`.

    Raises InputError: The variable has an unknown value.
    """
    return quality_for(renderer_name(), os.environ.get(VARIABLE, ""))


def renderer_name() -> str:
    """OpenGL name of the renderer; empty without OpenGL. Needs a Qt application."""
    surface, context = QOffscreenSurface(), QOpenGLContext()
    surface.create()
    if not (context.create() and context.makeCurrent(surface)):
        return ""
    name = context.functions().glGetString(_GL_RENDERER)
    context.doneCurrent()
    return str(name or "")


PLATFORMS = frozenset({"xcb"})
"""Qt platforms on which native child windows were tested."""

_LEQUAL, _BACK, _SCISSOR_TEST, _COLOR_BUFFER_BIT, _NEAREST = 0x0203, 0x0405, 0x0C11, 0x4000, 0x2600
_READ_FRAMEBUFFER, _DRAW_FRAMEBUFFER, _COLOR_ATTACHMENT0 = 0x8CA8, 0x8CA9, 0x8CE0

POINTS_PER_INCH = 72
"""Resolution at which a font size is a number of pixels."""
CLICK = 3.0
"""Largest movement of the mouse in a click, screen pixels."""
LIGHTS = (((-0.5, 0.7, 1.0), 0.75), ((0.8, -0.3, 0.6), 0.35))
"""Direction in camera coordinates (right, up, towards the camera), and intensity."""


class View(QtInteractor):  # type: ignore[misc]
    """View of the sensor; `refresh()` requests a redraw when the event loop is idle.

    VTK's own renders on mouse moves are also such requests, so that any number of changes costs one
    render.
    """

    dropped_files = Signal(list)  # Paths
    rendering = Signal()  # Before a render, for layout in pixels
    rendered = Signal()  # A new picture is on the screen
    mouse_moved = Signal(float, float)  # Position in Qt pixels, without a pressed button
    clicked = Signal(float, float)  # Position in Qt pixels, of a left click without a drag
    mouse_left = Signal()
    resized = Signal()

    def __init__(self, parent: QWidget, quality: RenderQuality) -> None:
        super().__init__(parent, auto_update=False, multi_samples=quality.samples, lighting="none")
        self.quality = quality
        if quality.own_swap and QGuiApplication.platformName() in PLATFORMS:
            # a native window for the view alone, before it is created
            QGuiApplication.setAttribute(Qt.ApplicationAttribute.AA_DontCreateNativeWidgetSiblings)
            self.setAttribute(Qt.WidgetAttribute.WA_DontCreateNativeAncestors)
            self.setAttribute(Qt.WidgetAttribute.WA_NativeWindow)
        self.render_rate = RateMeter()
        self.render_count = 0
        self.pointer_props: list[Any] = []  # Follow the mouse; hidden in saved pictures
        self.busy_s = 0.0  # Time of the GUI thread spent on updating and rendering the scene
        self._due = Throttle(self, self._draw)
        self.frameSwapped.connect(self._on_swapped)
        # no gradient, which costs a quarter of an empty render
        self.follow_theme(lambda colours: self.set_background(colours.view))
        self._tags = [
            (subject, subject.AddObserver(event, callback))
            for subject, event, callback in (
                (self.ren_win, "StartEvent", lambda *_: self.rendering.emit()),
                (self.ren_win, "EndEvent", self._count_render),
                (self.iren.interactor, "RenderEvent", self._on_vtk_render_request),
            )
        ]
        self.iren.interactor.EnableRenderOff()
        self.renderer.camera.is_set = True  # pyvista would place it itself, and render for that
        for position, intensity in LIGHTS:
            light = pv.Light(light_type="camera light", intensity=intensity)
            light.position = position
            self.add_light(light)

    def refresh(self) -> None:
        """Request a redraw; calls before it is drawn are merged."""
        self._due.request()

    @property
    def redraw_due(self) -> bool:
        """Whether a redraw was requested and is not done yet: the window's paint waits for it."""
        return self._due.isActive()

    def follow_theme(self, paint: Callable[[theme.Colours], object]) -> None:
        """Call `paint` with the theme's colours, now and after each change of theme."""
        paint(theme.of(self))
        self._painters = (*self._painters, paint)

    _painters: tuple[Callable[[theme.Colours], object], ...] = ()

    def changeEvent(self, event: QEvent) -> None:
        """Follow the window's theme."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange:
            for paint in self._painters:
                paint(theme.of(self))
            self.refresh()

    @property
    def pixel_ratio(self) -> float:
        """Pixels of the picture per Qt pixel, the unit of text sizes."""
        return float(self.ren_win.GetDPI()) / POINTS_PER_INCH

    @property
    def size_px(self) -> tuple[float, float]:
        """Width and height of the picture being rendered, in Qt pixels."""
        width, height = self.ren_win.GetSize()
        return width / self.pixel_ratio, height / self.pixel_ratio

    def screen_position(self, point_m: np.ndarray) -> QPointF:
        """Position of a point (3,) in B in the view, in Qt pixels."""
        self.renderer.SetWorldPoint(*point_m, 1.0)
        self.renderer.WorldToDisplay()
        x, y, _ = self.renderer.GetDisplayPoint()
        ratio = self.devicePixelRatioF()
        return QPointF(x / ratio, self.height() - 1 - y / ratio)

    def projected(self, points_m: np.ndarray) -> np.ndarray:
        """Normalised view coordinates (k, 3) of points (k, 3) in B: right, up, depth, −1 to 1."""
        aspect = self.width() / max(self.height(), 1)
        matrix = self.camera.GetCompositeProjectionTransformMatrix(aspect, -1.0, 1.0)
        T = np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])
        across = points_m @ T[:, :3].T + T[:, 3]
        return np.asarray(across[:, :3] / across[:, 3:])

    def paintGL(self) -> None:
        """Render for Qt when it composes the window: first, after resizing, for a screenshot."""
        if self._resizing:  # Qt asks again when it composes the window
            return
        start = time.perf_counter()
        self._newer_than_qt = False
        if self.redraw_due:
            self._leave_to_qt()  # what was to be redrawn is drawn now
        super().paintGL()
        self.busy_s += time.perf_counter() - start

    def _draw(self) -> None:
        """Render and swap buffers directly, or through Qt if that is not possible.

        Qt composes a window with an OpenGL widget completely for every picture, which without a GPU
        takes longer than rendering. A widget with a native window can be swapped alone.
        """
        window, own = self.ren_win, self.windowHandle()
        native = self.testAttribute(Qt.WidgetAttribute.WA_NativeWindow)
        exposed = native and own is not None and own.isExposed()
        if not (exposed and self.context() is not None and window.GetReadyForRendering()):
            self.update()
            self._leave_to_qt()
            return
        start = time.perf_counter()
        self.makeCurrent()
        self._in_paint = True  # else pyvistaqt would ask Qt to repaint
        state = window.GetState()  # which Qt may have changed
        state.Reset()
        state.Push()
        state.vtkglDepthFunc(_LEQUAL)
        window.Render()
        state.Pop()
        self._in_paint = False
        self._swap()
        self._newer_than_qt = True
        self.doneCurrent()
        self.busy_s += time.perf_counter() - start
        self._on_screen()
        # at once: another result may be waiting
        QCoreApplication.sendEvent(self.window(), QEvent(QEvent.Type.UpdateRequest))

    def _leave_to_qt(self) -> None:
        """Let Qt paint the window, which waited for a redraw that is no longer due."""
        self._due.stop()
        QCoreApplication.postEvent(self.window(), QEvent(QEvent.Type.UpdateRequest))

    def _swap(self) -> None:
        """Copy VTK's picture to the native window."""
        context, window = self.context(), self.windowHandle()
        context.makeCurrent(window)
        gl = context.extraFunctions()  # VTK's own blit would make its off-screen surface current
        picture = self.ren_win.GetDisplayFramebuffer().GetFBOIndex()
        gl.glBindFramebuffer(_READ_FRAMEBUFFER, picture)
        gl.glReadBuffer(_COLOR_ATTACHMENT0)
        gl.glBindFramebuffer(_DRAW_FRAMEBUFFER, 0)
        gl.glDrawBuffers(1, [_BACK])
        gl.glDisable(_SCISSOR_TEST)
        area = (0, 0, *self.ren_win.GetSize())
        gl.glBlitFramebuffer(*area, *area, _COLOR_BUFFER_BIT, _NEAREST)
        context.swapBuffers(window)

    def close(self) -> None:
        """Release VTK's render window and all observers that would keep it alive."""
        self._due.stop()
        for subject, tag in self._tags:
            subject.RemoveObserver(tag)
        self._tags, self._painters = [], ()
        super().close()

    def showEvent(self, event: QShowEvent) -> None:
        """Watch expose events of the view's native window, if any, and of its parent."""
        super().showEvent(event)
        own, around = self.windowHandle(), self.window().windowHandle()
        for window in (own, around) if own is not None else ():
            window.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Redraw areas that were uncovered.

        Qt holds only the last picture that it drew itself, which may be old. Around a native child
        window Qt does not repaint uncovered areas: without a compositor, closed menus and dialogs
        would stay on the screen.
        """
        if watched is self.windowHandle():
            if event.type() == QEvent.Type.Expose and self._newer_than_qt:
                self.refresh()
        elif isinstance(event, QPaintEvent) and isinstance(watched, QWindow):
            self.window().update(event.region())
        return bool(super().eventFilter(watched, event))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Rotate the scene while a button is pressed, else emit `mouse_moved`."""
        super().mouseMoveEvent(event)
        if not event.buttons():
            self.mouse_moved.emit(event.position().x(), event.position().y())

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Start a rotation or a click."""
        super().mousePressEvent(event)
        self._pressed = event.position()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        """End the rotation or the click."""
        super().mouseReleaseEvent(event)
        moved = event.position() - self._pressed
        if event.button() == Qt.MouseButton.LeftButton and moved.manhattanLength() <= CLICK:
            self.clicked.emit(event.position().x(), event.position().y())

    _pressed = QPointF(-1e6, -1e6)

    def resizeEvent(self, event: QResizeEvent) -> None:
        self._resizing = True
        super().resizeEvent(event)
        self._resizing = False
        self.resized.emit()
        self.update()
        self._leave_to_qt()

    _resizing = False

    def leaveEvent(self, event: QEvent) -> None:
        super().leaveEvent(event)
        self.mouse_left.emit()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Pass keys to the window; VTK's own would quit or change the style."""
        event.ignore()

    def keyReleaseEvent(self, event: QKeyEvent) -> None:
        event.ignore()

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        if event.mimeData().hasUrls():
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        """Pass dropped files to the window instead of reading them as meshes."""
        paths = [Path(url.toLocalFile()) for url in event.mimeData().urls() if url.isLocalFile()]
        if paths:
            event.acceptProposedAction()
            self.dropped_files.emit(paths)

    def _count_render(self, *_: Any) -> None:
        self.render_count += 1
        self.render_rate.tick(time.perf_counter())
        self._new_picture = True

    _new_picture = False
    _newer_than_qt = False
    """The picture on the screen is newer than the one Qt holds."""

    def _on_swapped(self) -> None:
        """Redraw after Qt has composed the window with an older picture."""
        if self._newer_than_qt:
            self.refresh()
        self._on_screen()

    def _on_screen(self) -> None:
        """Emit `rendered`, unless Qt composed the window for another reason."""
        if self._new_picture:
            self._new_picture = False
            self.rendered.emit()

    def _on_vtk_render_request(self, *_: Any) -> None:
        """Render while painting, else request a redraw.

        The interactor itself never renders (`EnableRenderOff`), as it would hold the GIL and block
        the solver thread meanwhile; the render window releases it.
        """
        if self._in_paint:
            self.ren_win.Render()
        else:
            self.refresh()
