"""Dark and light theme: colours and style sheet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QApplication, QMainWindow, QWidget

from bubbleviz_ui.model.settings import ThemeName

_FOLDER = Path(__file__).parent.as_posix()

# Colours with a meaning, the same in every theme.
NEUTRAL = "#8c97a5"
"""The membrane without contact."""
WIREFRAME = "#5d6876"
LINE, FAINT_LINE = "#ffffff", "#d4d8dd"
"""Opaque, as translucent lines would need a second render pass."""
FORCE = "#35d0ba"
NEARER = "#2a6fff"
FARTHER = "#13a35b"
PATCH_POINT = "#b4f52e"
UNKNOWN = "#5b6470"
"""Missing values."""
NODE = "#ff5ccd"
CONTACT = "#e0662f"
UNTRUSTED = "#b558d6"
"""Untrusted frames."""
BETWEEN = "#e8edf2"
"""Middle of a diverging map on the membrane."""
AMBER = "#f2b233"
GAP = "#e5484d"
BLUE, ORANGE, GREEN = "#4c9fe8", "#f0883e", "#35c07a"
"""Curves; distinguishable with any colour vision, on dark and on light."""
COMPARED = "#37c8ff", "#b4f52e"
"""Outlines of the settings A and B of Compare."""
OBJECT_PATCH = "#3dff8f"
"""Outline of the patch by the object; green like an object that was found."""
YELLOW = "#f2c14e"
"""Simulated sources."""
ON_BADGE = "#0b1118"
"""Text on a badge."""


@dataclass(frozen=True)
class Colours:
    """Colours of a theme."""

    view: str  # view, cloud, rim, frustum: 3-D view: background, points, lines
    cloud: str
    rim: str
    frustum: str
    window: str  # window, panel, field, border: Surfaces; `field` of input widgets
    panel: str
    field: str
    border: str
    text: str  # text, dim, disabled: Text
    dim: str
    disabled: str
    # accent, on_accent, tick: Selection, text on it, and file of the check mark on it
    accent: str
    on_accent: str
    tick: str
    button: str  # button, hover, outline: Buttons, and frame of check boxes
    hover: str
    outline: str
    error: str  # error, error_edge, warning, warning_edge: The message bar
    error_edge: str
    warning: str
    warning_edge: str
    free: str  # free, marker: On the timeline: frames without contact, marked frames
    marker: str
    good: str  # good, usable, doubtful: Grades
    usable: str
    doubtful: str


DARK = Colours(
    view="#191d22",
    cloud="#cfd6de",
    rim="#c3ccd6",
    frustum="#7f8b99",
    window="#1d2126",
    panel="#23282e",
    field="#171a1e",
    border="#3a414a",
    text="#e6ebf0",
    dim="#98a3af",
    disabled="#7d8792",
    accent="#4c9fe8",
    on_accent="#0b1118",
    tick="tick_dark.svg",
    button="#2f353d",
    hover="#3a424c",
    outline="#66717e",
    error="#5a2b2b",
    error_edge="#b05050",
    warning="#4a3d1e",
    warning_edge="#a5853a",
    free="#3d4c5c",
    marker="#f2c14e",
    good="#4cc38a",
    usable="#e5b567",
    doubtful="#f07178",
)
LIGHT = Colours(
    view="#f2f4f7",
    cloud="#38424d",
    rim="#4a5561",
    frustum="#7f8b99",
    window="#dfe3e8",
    panel="#eceff3",
    field="#ffffff",
    border="#bcc4cd",
    text="#161b21",
    dim="#55606c",
    disabled="#757f89",
    accent="#1560b3",
    on_accent="#ffffff",
    tick="tick_white.svg",
    button="#fafbfc",
    hover="#dde6f0",
    outline="#7b8794",
    error="#f9d9d7",
    error_edge="#c7625c",
    warning="#fbeecb",
    warning_edge="#c39a2c",
    free="#a9bccf",
    marker="#b07a00",
    good="#15803d",
    usable="#9a6200",
    doubtful="#c2303a",
)


def of(widget: QWidget) -> Colours:
    """Current theme of a widget."""
    return with_text(widget.palette().color(QPalette.ColorRole.Text))


def with_text(colour: QColor) -> Colours:
    """Theme with text of this colour."""
    return DARK if colour.lightness() > 127 else LIGHT


def chosen(theme: ThemeName, scheme: Qt.ColorScheme) -> Colours:
    """Colours for a theme setting; dark if the system's scheme is unknown."""
    light = theme == "light" or (theme == "system" and scheme == Qt.ColorScheme.Light)
    return LIGHT if light else DARK


def system_scheme() -> Qt.ColorScheme:
    """Colour scheme of the desktop, possibly unknown."""
    return QApplication.styleHints().colorScheme()


def apply(application: QApplication, colours: Colours) -> None:
    """Apply a theme to the application and its main windows."""
    new = palette(colours)
    if application.palette() != new:
        application.setPalette(new)
        for window in application.topLevelWidgets():
            if isinstance(window, QMainWindow):
                window.setStyleSheet(style_sheet(colours))


def style_sheet(c: Colours) -> str:
    """Style sheet of a theme, for a window: Qt applies that of an application more slowly.

    Text and selections are coloured by the palette: a rule for every widget is slow, too.
    """
    return f"""
QMenu::item:selected, QMenuBar::item:selected {{ background: {c.hover}; color: {c.text}; }}
QMenu::item {{ padding: 3px 24px 3px 16px; }}
QMenu::indicator {{ left: 8px; }}
QMenu::indicator:exclusive {{ border-radius: 7px; }}
QMenu::separator {{ height: 1px; background: {c.outline}; margin: 3px 8px; }}
QMenu::item:disabled, QAbstractItemView::item:disabled {{ color: {c.disabled}; }}
QMainWindow, QDialog {{ background: {c.window}; }}
QMainWindow::separator {{ background: {c.field}; width: 4px; height: 4px; }}
QDockWidget {{ font-weight: 600; }}
QDockWidget::title {{ background: {c.panel}; padding: 6px 10px;
    border-bottom: 1px solid {c.border}; }}
QDockWidget > QWidget {{ background: {c.panel}; }}
QToolTip {{ background: {c.field}; color: {c.text}; border: 1px solid {c.border}; padding: 4px; }}
QStatusBar {{ background: {c.field}; border-top: 1px solid {c.border}; }}
QStatusBar::item {{ border: none; }}
QLabel#dim {{ color: {c.dim}; }}
QLabel#value {{ font-weight: 600; }}
QLabel#doubt {{ color: {c.doubtful}; font-weight: 600; }}
QPushButton, QToolButton {{ background: {c.button}; border: 1px solid {c.border};
    border-radius: 4px; padding: 4px 10px; }}
QToolButton {{ padding: 4px 5px; }}
QToolButton#slim {{ padding: 4px 2px; }}
QPushButton:hover, QToolButton:hover {{ background: {c.hover}; }}
QPushButton:checked, QToolButton:checked {{ background: {c.accent}; color: {c.on_accent}; }}
QPushButton#main:enabled {{ background: {c.accent}; color: {c.on_accent}; }}
QPushButton:focus, QToolButton:focus, QComboBox:focus, QDoubleSpinBox:focus
    {{ border: 1px solid {c.accent}; }}
QAbstractSpinBox {{ min-height: 1.35em; }}
QCheckBox {{ spacing: 8px; padding: 2px; }}
QCheckBox::indicator, QMenu::indicator {{ width: 13px; height: 13px; border: 1px solid {c.outline};
    border-radius: 3px; background: {c.field}; }}
QCheckBox::indicator:checked, QMenu::indicator:checked
    {{ background: {c.accent}; border-color: {c.accent};
    image: url("{_FOLDER}/{c.tick}"); }}
QCheckBox:focus {{ color: {c.accent}; }}
QFrame#line {{ color: {c.border}; background: {c.border}; border: none; max-height: 1px; }}
QFrame#live {{ background: {c.panel}; border: none; border-bottom: 1px solid {c.border}; }}
QFrame#error {{ background: {c.error}; border: none;
    border-bottom: 1px solid {c.error_edge}; }}
QFrame#warning {{ background: {c.warning}; border: none;
    border-bottom: 1px solid {c.warning_edge}; }}
QFrame#busy, QFrame#hint, QFrame#notice {{ background: {c.panel}; border: none;
    border-bottom: 1px solid {c.border}; }}
QFrame#notice QToolButton {{ padding: 0 6px; }}
"""


def palette(c: Colours) -> QPalette:
    """Palette of a theme for Qt's Fusion style."""
    roles = QPalette.ColorRole
    colours = {
        roles.Window: c.window,
        roles.WindowText: c.text,
        roles.Base: c.field,
        roles.AlternateBase: c.panel,
        roles.Text: c.text,
        roles.Button: c.panel,
        roles.ButtonText: c.text,
        roles.ToolTipBase: c.field,
        roles.ToolTipText: c.text,
        roles.Highlight: c.accent,
        roles.HighlightedText: c.on_accent,
        roles.PlaceholderText: c.dim,
        roles.Link: c.accent,
        roles.LinkVisited: c.accent,
    }
    made = QPalette()
    for role, colour in colours.items():
        made.setColor(role, QColor(colour))
    for role in (roles.WindowText, roles.Text, roles.ButtonText):
        made.setColor(QPalette.ColorGroup.Disabled, role, QColor(c.disabled))
    return made
