"""The 3-D view: a VTK render window in Qt that draws once, however often it is asked to."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvista as pv
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, QTimer, Signal
from PySide6.QtGui import (
    QDragEnterEvent,
    QDropEvent,
    QGuiApplication,
    QImage,
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
from bubbleviz_ui.model.messages import RateMeter
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d import render_view as direct_swap

if TYPE_CHECKING:
    from PySide6.QtOpenGLWidgets import QOpenGLWidget


# How well the 3-D view is drawn, by what draws it: a GPU, or the processor that also solves.


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
    """What the 3-D view spends on a picture."""

    name: str  # What `BUBBLEVIZ_RENDERING` calls it
    samples: int  # Samples a pixel, for smooth edges; 0 for none
    round_points: bool  # Points are shaded balls instead of flat squares
    cloud_decimation: (
        int  # One in so many points of the cloud is drawn while frames follow each other
    )
    # The view puts its pictures on the screen itself, see `direct_swap`; else Qt does
    own_swap: bool
    renderer: str = ""  # What the driver calls itself; empty where it was not asked

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


FAST = RenderQuality("fast", samples=0, round_points=False, cloud_decimation=4, own_swap=True)
SMOOTH = RenderQuality(
    "smooth", samples=SAMPLES, round_points=True, cloud_decimation=1, own_swap=False
)


def quality_for(renderer: str, wanted: str = "") -> RenderQuality:
    """Fast for software or an unknown renderer, smooth for any other, unless one is wanted.

    Raises InputError: There is no such quality.

    `renderer`: OpenGL's name of it.
    `wanted`: Name of a quality; empty for the renderer's.
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

    Raises InputError: The variable names none.
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


POINTS_PER_INCH = 72
"""Resolution of a picture in which text has as many pixels as its font size says."""
CLICK = 3.0
"""How far the mouse may move in a click, screen pixels."""
LIGHTS = (((-0.5, 0.7, 1.0), 0.75), ((0.8, -0.3, 0.6), 0.35))
"""Where each is, seen from the camera (right, up, towards it), and its intensity."""


class View(QtInteractor):  # type: ignore[misc]
    """View of the sensor; `refresh()` asks for a picture, which comes when nothing else waits.

    VTK's own renders on mouse moves are such requests too, so any number of changes between two
    pictures costs one render.
    """

    dropped_files = Signal(list)  # List of paths the user dropped on the view
    # A picture is about to be made, perhaps of another size: what is laid out by pixels is now
    rendering = Signal()
    rendered = Signal()  # A new picture is on the screen
    moved = Signal(float, float)  # Where the mouse is, in Qt's pixels, while no button is held
    # Where the left button was pressed and let go without moving, in Qt's pixels
    clicked = Signal(float, float)
    left = Signal()  # The mouse is elsewhere
    resized = Signal()  # The view has another size

    def __init__(self, parent: QWidget, quality: RenderQuality) -> None:
        super().__init__(parent, auto_update=False, multi_samples=quality.samples, lighting="none")
        self.quality = quality
        if quality.own_swap:
            direct_swap.prepare(self)
        self.renders = RateMeter()  # Real renders of VTK
        self.render_count = 0  # Renders since the view exists
        # Props that say what the mouse points at: seen in the window, not in pictures of the view
        self.of_the_mouse: list[Any] = []
        # Time the GUI thread has spent on pictures: changing the scene and rendering it, s
        self.busy_s = 0.0
        self._due = QTimer(self, singleShot=True)
        self._due.timeout.connect(self._draw)
        self.frameSwapped.connect(self._on_swapped)
        # Plain: a gradient costs a quarter of an empty render.
        self.follow_theme(lambda colours: self.set_background(colours.view))
        self._tags = [
            (subject, subject.AddObserver(event, callback))
            for subject, event, callback in (
                (self.ren_win, "StartEvent", lambda *_: self.rendering.emit()),
                (self.ren_win, "EndEvent", self._count_render),
                (self.iren.interactor, "RenderEvent", self._on_vtk_wants_render),
            )
        ]
        self.iren.interactor.EnableRenderOff()
        self.renderer.camera.is_set = True  # pyvista would place it itself, and render for that
        self._add_lights()

    def refresh(self) -> None:
        """Ask for a picture; many calls before it is drawn are one render."""
        if not self._due.isActive():
            self._due.start()

    def follow_theme(self, paint: Callable[[theme.Colours], object]) -> None:
        """Call `paint` with the theme's colours, now and whenever it is another."""
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

    def pixels(self) -> np.ndarray:
        """What the view shows now, shape (height, width, 3), uint8."""
        image = self.grabFramebuffer().convertToFormat(QImage.Format.Format_RGB888)
        flat = np.frombuffer(image.constBits(), np.uint8)
        rows = flat.reshape(image.height(), image.bytesPerLine())[:, : 3 * image.width()]
        return rows.reshape(image.height(), image.width(), 3).copy()

    @property
    def pixel(self) -> float:
        """Qt's pixel, in which text has its size, in pixels of the picture that is made."""
        return float(self.ren_win.GetDPI()) / POINTS_PER_INCH

    @property
    def room(self) -> tuple[float, float]:
        """Width and height of the picture that is made, in Qt's pixels."""
        width, height = self.ren_win.GetSize()
        return width / self.pixel, height / self.pixel

    def place_of(self, point_m: np.ndarray) -> QPointF:
        """Where a point (3,) in B is drawn, in Qt's pixels."""
        self.renderer.SetWorldPoint(*point_m, 1.0)
        self.renderer.WorldToDisplay()
        x, y, _ = self.renderer.GetDisplayPoint()
        ratio = self.devicePixelRatioF()
        return QPointF(x / ratio, self.height() - 1 - y / ratio)

    def projected(self, points_m: np.ndarray) -> np.ndarray:
        """Where points (k, 3) in B are drawn, (k, 3): right, up and depth, −1 to 1 in the view."""
        aspect = self.width() / max(self.height(), 1)
        matrix = self.camera.GetCompositeProjectionTransformMatrix(aspect, -1.0, 1.0)
        T = np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])
        across = points_m @ T[:, :3].T + T[:, 3]
        return np.asarray(across[:, :3] / across[:, 3:])

    def paintGL(self) -> None:
        """Render for Qt, which puts the window together: at first, after resizing, to grab it."""
        start = time.perf_counter()
        self._ahead = False
        super().paintGL()
        self.busy_s += time.perf_counter() - start

    def _draw(self) -> None:
        """Render and put the picture on the screen, by Qt's way where there is no shorter one."""
        window = self.ren_win
        if not (direct_swap.can_show(self) and window.GetReadyForRendering()):
            self.update()
            return
        start = time.perf_counter()
        self.makeCurrent()
        self._in_paint = True  # pyvistaqt asks Qt to paint what is rendered at other times
        direct_swap.render(window)
        self._in_paint = False
        direct_swap.show(self, window)
        self._ahead = True
        self.doneCurrent()
        self.busy_s += time.perf_counter() - start
        self._on_screen()

    def close(self) -> None:
        """Let go of VTK's render window and of every observer that would keep it alive."""
        self._due.stop()
        for subject, tag in self._tags:
            subject.RemoveObserver(tag)
        self._tags, self._painters = [], ()
        super().close()

    def showEvent(self, event: QShowEvent) -> None:
        """Watch the view's own native window, where it has one, and the one around it."""
        super().showEvent(event)
        own, around = self.windowHandle(), self.window().windowHandle()
        for window in (own, around) if own is not None else ():
            window.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Draw anew what was covered.

        Qt has the last picture of the view that it drew itself, which may be old. Around a view
        with a native window of its own Qt flushes nothing that was uncovered: without a compositor,
        closed menus and dialogs would stay on the screen.
        """
        if watched is self.windowHandle():
            if event.type() == QEvent.Type.Expose:
                self.refresh()
        elif isinstance(event, QPaintEvent) and isinstance(watched, QWindow):
            self.window().update(event.region())
        return bool(super().eventFilter(watched, event))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Turn the scene while a button is held, else say where the mouse is."""
        super().mouseMoveEvent(event)
        if not event.buttons():
            self.moved.emit(event.position().x(), event.position().y())

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Begin to turn the scene, or a click."""
        super().mousePressEvent(event)
        self._pressed = event.position()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        """End turning, or the click."""
        super().mouseReleaseEvent(event)
        moved = event.position() - self._pressed
        if event.button() == Qt.MouseButton.LeftButton and moved.manhattanLength() <= CLICK:
            self.clicked.emit(event.position().x(), event.position().y())

    _pressed = QPointF(-1e6, -1e6)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Say that the size is another."""
        super().resizeEvent(event)
        self.resized.emit()

    def leaveEvent(self, event: QEvent) -> None:
        """Say that the mouse is elsewhere."""
        super().leaveEvent(event)
        self.left.emit()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Leave keys to the window: VTK's own would quit or change styles."""
        event.ignore()

    def keyReleaseEvent(self, event: QKeyEvent) -> None:
        """Leave keys to the window."""
        event.ignore()

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        """Accept files."""
        if event.mimeData().hasUrls():
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        """Hand dropped files to the window instead of reading them as meshes."""
        paths = [Path(url.toLocalFile()) for url in event.mimeData().urls() if url.isLocalFile()]
        if paths:
            event.acceptProposedAction()
            self.dropped_files.emit(paths)

    def _add_lights(self) -> None:
        for position, intensity in LIGHTS:
            light = pv.Light(light_type="camera light", intensity=intensity)
            light.position = position
            self.add_light(light)

    def _count_render(self, *_: Any) -> None:
        self.render_count += 1
        self.renders.tick(time.perf_counter())
        self._unseen = True

    _unseen = False
    _ahead = False
    """What was swapped is newer than the picture that Qt has of the view."""

    def _on_swapped(self) -> None:
        """Draw anew where Qt has put the window together with its own older picture."""
        if self._ahead:
            self.refresh()
        self._on_screen()

    def _on_screen(self) -> None:
        """Say so, unless Qt has put the window together for another reason."""
        if self._unseen:
            self._unseen = False
            self.rendered.emit()

    def _on_vtk_wants_render(self, *_: Any) -> None:
        """Render while painting, else ask for a picture.

        The interactor itself never renders (`EnableRenderOff`): it would keep Python's lock
        meanwhile, and the solver thread would wait for the picture. The window lets it go.
        """
        if self._in_paint:
            self.ren_win.Render()
        else:
            self.refresh()


# VTK's picture straight to the screen, without Qt putting the whole window together around it.
#
# Qt composes a window that has an OpenGL widget anew, all of it, for every picture. Where there is
# no GPU that takes longer than the picture. A widget with a native window of its own can be swapped
# alone, and the panels around it are painted as in any other window.


PLATFORMS = frozenset({"xcb"})
"""Qt's names of those where native windows inside others were tried."""

_LEQUAL, _BACK, _SCISSOR_TEST, _COLOR_BUFFER_BIT, _NEAREST = 0x0203, 0x0405, 0x0C11, 0x4000, 0x2600
_READ_FRAMEBUFFER, _DRAW_FRAMEBUFFER, _COLOR_ATTACHMENT0 = 0x8CA8, 0x8CA9, 0x8CE0


def prepare(widget: QOpenGLWidget) -> None:
    """Give a widget, and none beside it, a native window of its own, before it has any."""
    if QGuiApplication.platformName() in PLATFORMS:
        QGuiApplication.setAttribute(Qt.ApplicationAttribute.AA_DontCreateNativeWidgetSiblings)
        widget.setAttribute(Qt.WidgetAttribute.WA_DontCreateNativeAncestors)
        widget.setAttribute(Qt.WidgetAttribute.WA_NativeWindow)


def can_show(widget: QOpenGLWidget) -> bool:
    """Whether the widget is on the screen with a window of its own; Qt has painted it once."""
    if not widget.testAttribute(Qt.WidgetAttribute.WA_NativeWindow) or widget.context() is None:
        return False
    window = widget.windowHandle()
    return window is not None and window.isExposed()


def render(render_window: Any) -> None:
    """Have VTK render with the context that is current, which Qt has used meanwhile."""
    state = render_window.GetState()
    state.Reset()
    state.Push()
    state.vtkglDepthFunc(_LEQUAL)
    render_window.Render()
    state.Pop()


def show(widget: QOpenGLWidget, render_window: Any) -> None:
    """Put what VTK has rendered on the screen.

    `widget`: Of which `can_show` is true.
    `render_window`: Has rendered with the widget's context.
    """
    context, window = widget.context(), widget.windowHandle()
    context.makeCurrent(window)
    gl = context.extraFunctions()  # VTK's own blit would make its off-screen surface current
    gl.glBindFramebuffer(_READ_FRAMEBUFFER, render_window.GetDisplayFramebuffer().GetFBOIndex())
    gl.glReadBuffer(_COLOR_ATTACHMENT0)
    gl.glBindFramebuffer(_DRAW_FRAMEBUFFER, 0)
    gl.glDrawBuffers(1, [_BACK])
    gl.glDisable(_SCISSOR_TEST)
    width, height = render_window.GetSize()
    gl.glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, _COLOR_BUFFER_BIT, _NEAREST)
    context.swapBuffers(window)
