"""Colours and the style sheet of the window."""

from __future__ import annotations

from PySide6.QtGui import QColor, QPalette

VIEW = "#191d22"
NEUTRAL = "#8c97a5"
"""The membrane where nothing touches it."""
WIREFRAME = "#5d6876"
LINE = "#ffffff"
FORCE = "#35d0ba"
RIM = "#c3ccd6"
FRUSTUM = "#7f8b99"
CLOUD = "#cfd6de"
NEARER = "#2a6fff"
FARTHER = "#13a35b"
PATCH_POINT = "#b4f52e"
TEXT = "#e6ebf0"

WINDOW = "#1d2126"
PANEL = "#23282e"
FIELD = "#171a1e"
BORDER = "#3a414a"
ACCENT = "#4c9fe8"
DIM = "#98a3af"
DISABLED = "#666f79"

STYLE = f"""
QWidget {{ color: {TEXT}; }}
QPushButton:disabled, QToolButton:disabled {{ color: {DISABLED}; }}
QMainWindow, QDialog {{ background: {WINDOW}; }}
QMainWindow::separator {{ background: {FIELD}; width: 4px; height: 4px; }}
QDockWidget {{ font-weight: 600; }}
QDockWidget::title {{ background: {PANEL}; padding: 6px 10px; border-bottom: 1px solid {BORDER}; }}
QDockWidget > QWidget {{ background: {PANEL}; }}
QToolTip {{ background: {FIELD}; color: {TEXT}; border: 1px solid {BORDER}; padding: 4px; }}
QStatusBar {{ background: {FIELD}; border-top: 1px solid {BORDER}; }}
QStatusBar::item {{ border: none; }}
QLabel#dim {{ color: {DIM}; }}
QLabel#value {{ font-weight: 600; }}
QPushButton, QToolButton {{ background: #2f353d; border: 1px solid {BORDER}; border-radius: 4px;
    padding: 4px 10px; }}
QPushButton:hover, QToolButton:hover {{ background: #3a424c; }}
QPushButton:checked, QToolButton:checked {{ background: {ACCENT}; color: #0b1118; }}
QPushButton:focus, QToolButton:focus, QComboBox:focus, QDoubleSpinBox:focus
    {{ border: 1px solid {ACCENT}; }}
QCheckBox {{ spacing: 8px; padding: 2px; }}
QCheckBox::indicator {{ width: 13px; height: 13px; border: 1px solid #66717e; border-radius: 3px;
    background: {FIELD}; }}
QCheckBox::indicator:checked {{ background: {ACCENT}; border-color: {ACCENT}; }}
QCheckBox:focus {{ color: {ACCENT}; }}
QFrame#line {{ color: {BORDER}; background: {BORDER}; border: none; max-height: 1px; }}
QFrame#message {{ background: #5a2b2b; border: none; border-bottom: 1px solid #b05050; }}
"""


def palette() -> QPalette:
    """Dark palette for Qt's Fusion style."""
    roles = QPalette.ColorRole
    colours = {
        roles.Window: WINDOW,
        roles.WindowText: TEXT,
        roles.Base: FIELD,
        roles.AlternateBase: PANEL,
        roles.Text: TEXT,
        roles.Button: PANEL,
        roles.ButtonText: TEXT,
        roles.ToolTipBase: FIELD,
        roles.ToolTipText: TEXT,
        roles.Highlight: ACCENT,
        roles.HighlightedText: "#0b1118",
        roles.PlaceholderText: DIM,
    }
    made = QPalette()
    for role, colour in colours.items():
        made.setColor(role, QColor(colour))
    for role in (roles.WindowText, roles.Text, roles.ButtonText):
        made.setColor(QPalette.ColorGroup.Disabled, role, QColor(DISABLED))
    return made
