"""Controls bound to `Settings`, and which keys and wheel events the controls of a panel get."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from PySide6.QtCore import QEvent, QObject, QSignalBlocker, Qt
from PySide6.QtGui import QAction, QKeyEvent, QKeySequence
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSlider,
    QAbstractSpinBox,
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLayout,
    QLineEdit,
    QMenu,
    QSlider,
    QSpinBox,
    QToolButton,
    QWidget,
)

from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import SettingInfo, Settings
from bubbleviz_ui.model.units import UNIT_CHOICES, Unit, Units
from bubbleviz_ui.shell.dock import fill, tool_button


class SliderBox(QWidget):
    """Slider beside the box of a number; `valueChanged` as of the box."""

    STEPS = 300

    def __init__(self, box: QDoubleSpinBox, tip: str, *, logarithmic: bool = False) -> None:
        super().__init__()
        self.slider, self.box, self._logarithmic = (
            QSlider(Qt.Orientation.Horizontal),
            box,
            logarithmic,
        )
        self.slider.setRange(0, self.STEPS)
        for part in (self.slider, box):
            part.setToolTip(tip)
        box.setKeyboardTracking(False)
        fill(QHBoxLayout(self), (self.slider, 1), box, margins=(0, 0, 0, 0))
        self.value, self.setValue, self.valueChanged = box.value, box.setValue, box.valueChanged
        self.slider.valueChanged.connect(self._on_slider)
        box.valueChanged.connect(self._follow)
        self._follow(box.value())

    def show_value(self, value: float) -> None:
        """Show a value without `valueChanged`."""
        with QSignalBlocker(self.box):
            self.box.setValue(value)
        if not self.slider.isSliderDown():  # else it would jump to where the box rounds it
            self._follow(value)

    def _on_slider(self, place: int) -> None:
        low, high = self._ends
        value = low + (high - low) * place / self.STEPS
        self.box.setValue(10.0**value if self._logarithmic else value)

    def _follow(self, value: float) -> None:
        low, high = self._ends
        value = math.log10(value) if self._logarithmic else value
        with QSignalBlocker(self.slider):
            self.slider.setValue(round((value - low) / (high - low) * self.STEPS))

    @property
    def _ends(self) -> tuple[float, float]:
        low, high = self.box.minimum(), self.box.maximum()
        return (math.log10(low), math.log10(high)) if self._logarithmic else (low, high)


Box = QAbstractButton | QAbstractSlider | QSpinBox | QDoubleSpinBox | QComboBox
Control = Box | QAction | SliderBox


def _identity(value: Any) -> Any:
    return value


class Binding(QObject):
    """Two-way binding of a control and a settings field; owned by the control."""

    def __init__(
        self,
        control: Control,  # The items of a combo box have the values as their data
        state: SessionState,
        field: str,  # Of `Settings`
        # Control value of a settings value; None leaves a button or number unchanged
        shown: Callable[[Any], Any] = _identity,
        chosen: Callable[[Any], Any] = _identity,  # Settings value of a control value
    ) -> None:
        super().__init__(control)
        self._control, self._state, self._field = control, state, field
        self._shown, self._chosen = shown, chosen
        self._showing = False
        self.refresh()
        _changed(control).connect(self._on_set)
        state.settings_changed.connect(self._on_settings)

    def refresh(self) -> None:
        """Show the current value again, after the control's scale has changed."""
        self.show(getattr(self._state.settings, self._field))

    def show(self, value: Any) -> None:
        """Show a value without setting it."""
        self._showing = True
        _put(self._control, self._shown(value))
        self._showing = False

    def _on_set(self) -> None:
        if not self._showing:
            self._state.change(**{self._field: self._chosen(_get(self._control))})

    def _on_settings(self, names: frozenset[str]) -> None:
        if self._field in names or names & UNIT_CHOICES.keys():
            self.refresh()


def bind_membership(control: Control, state: SessionState, field: str, name: str) -> None:
    """Bind a checkable button or action to the membership of a name in a set."""

    def chosen(on: bool) -> frozenset[str]:
        names: frozenset[str] = getattr(state.settings, field)
        return names | {name} if on else names - {name}

    Binding(control, state, field, lambda names: name in names, chosen)


def bind_exclusive(control: Control, state: SessionState, field: str, option: str) -> None:
    """Bind one of several exclusive buttons or actions to a value of a field."""

    def chosen(on: bool) -> str:
        return option if on else getattr(state.settings, field)

    Binding(control, state, field, lambda value: value == option, chosen)


def control(
    state: SessionState,
    field: str,  # Of `Settings`
    info: SettingInfo | None = None,  # Of a part of the field, if the control edits only that
    get_part: Callable[[Any], Any] = _identity,  # Part of the field's value
    with_part: Callable[[Any], Any] = _identity,  # Field's value with the part changed
) -> Any:
    """Create the control of a setting and bind it."""
    info = Settings.info(field) if info is None else info
    box = widget(info)
    is_number = isinstance(box, QSpinBox | QDoubleSpinBox)
    number_for_none = info.low if info.number_for_none is None else info.number_for_none
    optional = get_part(getattr(Settings(), field)) is None

    def shown(value: Any) -> Any:
        value = get_part(value)
        if info.slider:
            return round(value / info.step)
        if not is_number:
            return value
        unit = _apply_unit(box, info, state.units)
        return unit.from_si(number_for_none if value is None else value)

    def chosen(value: Any) -> Any:
        if info.slider:
            value *= info.step
        elif is_number:
            value = _unit(info, state.units).to_si(value)
            value = round(value) if isinstance(box, QSpinBox) else value
            value = None if optional and value == number_for_none else value
        return with_part(value)

    Binding(box, state, field, shown, chosen)
    return box


def widget(info: SettingInfo) -> Box:
    """Unbound control of a setting: combo box, slider, number box or check box."""
    box: Box
    if info.titles is not None:
        box = options(QComboBox(), info.titles)
    elif info.slider:
        box = QSlider(Qt.Orientation.Horizontal)
        box.setRange(round(info.low / info.step), round(info.high / info.step))
    elif info.high > info.low:
        box = QSpinBox() if isinstance(info.low, int) else QDoubleSpinBox()
        box.setSpecialValueText(info.lowest)
        box.setKeyboardTracking(False)
    else:
        box = QCheckBox(info.label)
    box.setToolTip(info.tip)
    box.setAccessibleName(info.label)
    return box


def form(*rows: QWidget | tuple[str, QWidget | QLayout]) -> QFormLayout:
    """Form of controls with their labels, or of rows with these titles."""
    made = QFormLayout()
    for row in rows:
        if isinstance(row, tuple):
            title, box = row
            made.addRow(title, box)
        else:
            made.addRow("" if isinstance(row, QCheckBox) else row.accessibleName(), row)
    return made


def _unit(info: SettingInfo, units: Units) -> Unit:
    unit: Unit = getattr(units, info.unit) if isinstance(info.unit, str) else info.unit
    return unit


def _apply_unit(box: Any, info: SettingInfo, units: Units) -> Unit:
    """Set range, step and suffix of a number box in the current unit."""
    unit = _unit(info, units)
    if isinstance(box, QDoubleSpinBox):
        box.setDecimals(unit.digits)
    number = float if isinstance(box, QDoubleSpinBox) else round
    box.setRange(number(unit.from_si(info.low)), number(unit.from_si(info.high)))
    box.setSingleStep(number(unit.from_si(info.step)))
    box.setSuffix(f" {unit.symbol}" if unit.symbol else "")
    return unit


def menu_button(state: SessionState, field: str) -> tuple[QToolButton, dict[str, QAction]]:
    """Button with a menu of check marks, bound to the names in a set."""
    info, actions = Settings.info(field), dict[str, QAction]()
    button = tool_button(info.label, info.tip)
    button.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
    menu = QMenu(button)
    for name, title in (info.titles or {}).items():
        actions[name] = action = menu.addAction(title)
        action.setCheckable(True)
        bind_membership(action, state, field, name)
    button.setMenu(menu)
    return button, actions


def options(box: QComboBox, titles: Mapping[Any, str]) -> QComboBox:
    """Fill a combo box with titles, without the mnemonics of menus, and values."""
    for value, title in titles.items():
        box.addItem(title.replace("&", ""), value)
    return box


def _changed(control: Control) -> Any:
    if isinstance(control, QComboBox):
        return control.currentIndexChanged
    return control.toggled if isinstance(control, _SWITCHES) else control.valueChanged


def _get(control: Control) -> Any:
    if isinstance(control, QComboBox):
        return control.currentData()
    return control.isChecked() if isinstance(control, _SWITCHES) else control.value()


def _put(control: Control, value: Any) -> None:
    if isinstance(control, QComboBox):
        control.setCurrentIndex(control.findData(value))
    elif value is not None and value != _get(control):  # else keep what is being typed
        control.setChecked(value) if isinstance(control, _SWITCHES) else control.setValue(value)


_SWITCHES = (QAbstractButton, QAction)


# Keys and mouse wheel of a panel's controls.
#
# A control focused by Tab keeps its own keys; otherwise they play and seek. A control without focus
# ignores the wheel, so that scrolling a panel changes no setting.


BUTTON_KEYS = frozenset({Qt.Key.Key_Space})
SLIDER_KEYS = frozenset({Qt.Key.Key_Left, Qt.Key.Key_Right, Qt.Key.Key_Home, Qt.Key.Key_End})


UNDO_KEYS = QKeySequence.StandardKey.Undo, QKeySequence.StandardKey.Redo


class ControlInput(QObject):
    """Event filter of controls: without focus they ignore the wheel.

    With it, a control gets its keys before shortcuts.
    """

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Claim the keys of the focused control, and reject the wheel without focus."""
        if event.type() == QEvent.Type.Wheel and isinstance(watched, QWidget):
            event.setAccepted(watched.hasFocus())
            return not watched.hasFocus()
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            if isinstance(watched, QAbstractSpinBox | QLineEdit):
                undoes = any(map(event.matches, UNDO_KEYS))
                if undoes:
                    event.ignore()  # text boxes leave undo and redo to the window
                return undoes
            keys = BUTTON_KEYS if isinstance(watched, QAbstractButton) else SLIDER_KEYS
            if event.key() in keys:
                event.accept()
                return True
        return False


def watch_controls(panel: QWidget) -> None:
    """Make every control of a panel reachable by Tab, and prevent accidental changes.

    Buttons, sliders and combo boxes take no focus on a click, number boxes none from the wheel.
    """
    control_input = ControlInput(panel)
    for kind in (QAbstractButton, QSlider, QComboBox):
        for widget in panel.findChildren(kind):
            widget.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            widget.installEventFilter(control_input)
    for box in panel.findChildren(QAbstractSpinBox):
        box.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        box.installEventFilter(control_input)
    for line in panel.findChildren(QLineEdit):
        line.installEventFilter(control_input)
