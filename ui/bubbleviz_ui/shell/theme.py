"""Dark and light theme: a palette, which Qt applies faster than a style sheet."""

from __future__ import annotations

from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QColor, QPainter, QPalette
from PySide6.QtWidgets import (
    QApplication,
    QLabel,
    QProxyStyle,
    QPushButton,
    QStyle,
    QStyleOption,
    QStyleOptionComplex,
    QStyleOptionMenuItem,
    QToolTip,
    QWidget,
)

from bubbleviz_ui.model.settings import ThemeName

ROLES = QPalette.ColorRole
ERROR, WARNING, DOUBTFUL = ROLES.Midlight, ROLES.Mid, ROLES.BrightText
"""Roles of the palette, not used by Qt's Fusion style: grounds of messages, text of doubts."""

# Colours with a meaning, the same in every theme.
NEUTRAL = "#8c97a5"
"""The membrane without contact."""
WIREFRAME = "#5d6876"
LINE, FAINT_LINE = "#ffffff", "#d4d8dd"
"""Opaque, as translucent lines would need a second render pass."""
FORCE = "#35d0ba"
NEARER = "#2a6fff"
FARTHER = "#f06bc0"
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


class Colours:
    """Colours of the dark theme, or of the light one."""

    def __init__(self, *, light: bool) -> None:
        def of_theme(dark: str, bright: str) -> str:
            return bright if light else dark

        # 3-D view: background, points, lines
        self.view = of_theme("#191d22", "#f2f4f7")
        self.cloud = of_theme("#cfd6de", "#38424d")
        self.rim = of_theme("#c3ccd6", "#4a5561")
        self.frustum = of_theme("#7f8b99", "#7f8b99")
        # Windows, input widgets, and text on them
        self.window = of_theme("#23282e", "#eceff3")
        self.field = of_theme("#171a1e", "#ffffff")
        self.text = of_theme("#e6ebf0", "#161b21")
        self.dim = of_theme("#98a3af", "#55606c")
        self.disabled = of_theme("#7d8792", "#757f89")
        # Selection, text on it, frame of check boxes
        self.accent = of_theme("#4c9fe8", "#1560b3")
        self.on_accent = of_theme("#0b1118", "#ffffff")
        self.outline = of_theme("#66717e", "#7b8794")
        # The message bar
        self.error = of_theme("#5a2b2b", "#f9d9d7")
        self.warning = of_theme("#4a3d1e", "#fbeecb")
        # On the timeline: frames without contact, marked frames
        self.free = of_theme("#3d4c5c", "#a9bccf")
        self.marker = of_theme("#f2c14e", "#b07a00")
        # Grades
        self.good = of_theme("#4cc38a", "#15803d")
        self.usable = of_theme("#e5b567", "#9a6200")
        self.doubtful = of_theme("#f07178", "#c2303a")


DARK, LIGHT = Colours(light=False), Colours(light=True)


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
    """Apply a theme to the application."""
    new = palette(colours)
    if application.palette() == new:
        return
    application.setPalette(new)
    kind = QEvent.Type.ApplicationPaletteChange
    application.sendPostedEvents(None, kind)  # all widgets have it now
    QToolTip.setPalette(new)


class Style(QProxyStyle):
    """Qt's Fusion style with checked and default buttons in the colour of selections."""

    def __init__(self) -> None:
        super().__init__("Fusion")

    def drawControl(
        self,
        element: QStyle.ControlElement,
        option: QStyleOption,
        painter: QPainter,
        widget: QWidget | None = None,
    ) -> None:
        if element == QStyle.ControlElement.CE_PushButton:
            default = isinstance(widget, QPushButton) and widget.isDefault()
            _emphasise(option, default=default)
        elif element == QStyle.ControlElement.CE_MenuItem:
            _outline(option)
            kind = getattr(option, "menuItemType", None)
            if kind == QStyleOptionMenuItem.MenuItemType.Separator:
                line = option.rect.adjusted(8, option.rect.height() // 2, -8, 0)
                line.setHeight(1)
                painter.fillRect(line, _colours(option).outline)
                return
        super().drawControl(element, option, painter, widget)

    def drawComplexControl(
        self,
        control: QStyle.ComplexControl,
        option: QStyleOptionComplex,
        painter: QPainter,
        widget: QWidget | None = None,
    ) -> None:
        if control == QStyle.ComplexControl.CC_ToolButton:
            _emphasise(option)
        super().drawComplexControl(control, option, painter, widget)

    def drawPrimitive(
        self,
        element: QStyle.PrimitiveElement,
        option: QStyleOption,
        painter: QPainter,
        widget: QWidget | None = None,
    ) -> None:
        if element == QStyle.PrimitiveElement.PE_IndicatorCheckBox:
            _outline(option)
        super().drawPrimitive(element, option, painter, widget)


def _emphasise(option: QStyleOption, *, default: bool = False) -> None:
    """Colour a button that is checked, or the default one."""
    state, flags = option.state, QStyle.StateFlag
    if flags.State_Enabled in state and (default or flags.State_On in state):
        colours = QPalette(option.palette)
        colours.setColor(ROLES.Button, colours.color(ROLES.Highlight))
        colours.setColor(ROLES.ButtonText, colours.color(ROLES.HighlightedText))
        option.palette = colours


def _outline(option: QStyleOption) -> None:
    """Frame check boxes visibly: Fusion takes a darker colour of the window, dark or not."""
    colours = QPalette(option.palette)
    colours.setColor(ROLES.Window, QColor(_colours(option).outline).lighter(140))
    option.palette = colours


def _colours(option: QStyleOption) -> Colours:
    return with_text(option.palette.color(ROLES.Text))


def dim(label: QLabel) -> QLabel:
    """Give a label the colour of secondary text."""
    label.setForegroundRole(ROLES.PlaceholderText)
    return label


def bold(label: QLabel) -> QLabel:
    font = label.font()
    font.setBold(True)
    label.setFont(font)
    return label


def doubtful(label: QLabel) -> QLabel:
    """Give a label the look of a warning."""
    label.setForegroundRole(DOUBTFUL)
    return bold(label)


def palette(c: Colours) -> QPalette:
    """Palette of a theme for Qt's Fusion style."""
    colours = {
        ROLES.Window: c.window,
        ROLES.WindowText: c.text,
        ROLES.Base: c.field,
        ROLES.AlternateBase: c.window,
        ROLES.Text: c.text,
        ROLES.Button: c.window,
        ROLES.ButtonText: c.text,
        ROLES.ToolTipBase: c.field,
        ROLES.ToolTipText: c.text,
        ROLES.Highlight: c.accent,
        ROLES.HighlightedText: c.on_accent,
        ROLES.PlaceholderText: c.dim,
        ROLES.Link: c.accent,
        ROLES.LinkVisited: c.accent,
        ERROR: c.error,
        WARNING: c.warning,
        DOUBTFUL: c.doubtful,
    }
    made = QPalette()
    for role, colour in colours.items():
        made.setColor(role, QColor(colour))
    for role in (ROLES.WindowText, ROLES.Text, ROLES.ButtonText):
        made.setColor(QPalette.ColorGroup.Disabled, role, QColor(c.disabled))
    return made
