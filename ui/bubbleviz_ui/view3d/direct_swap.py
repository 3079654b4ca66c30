"""VTK's picture straight to the screen, without Qt putting the whole window together around it.

Qt composes a window that has an OpenGL widget anew, all of it, for every picture. Where there is no
GPU that takes longer than the picture. A widget with a native window of its own can be swapped
alone, and the panels around it are painted as in any other window.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from PySide6.QtCore import Qt
from PySide6.QtGui import QGuiApplication

if TYPE_CHECKING:
    from PySide6.QtOpenGLWidgets import QOpenGLWidget

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

    Parameters
    ----------
    widget : QOpenGLWidget
        Of which `can_show` is true.
    render_window : vtkGenericOpenGLRenderWindow
        Has rendered with the widget's context.
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
