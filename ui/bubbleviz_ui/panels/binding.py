"""Controls of settings: made from what `Settings` says of each, and bound to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QAction, QKeyEvent, QKeySequence
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSlider,
    QAbstractSpinBox,
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
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

Box = QAbstractButton | QAbstractSlider | QSpinBox | QDoubleSpinBox | QComboBox
Control = Box | QAction


def _same(value: Any) -> Any:
    return value


class Binding(QObject):
    """A control and its field of the settings, see `bind`; it lives as long as the control."""

    def __init__(
        self,
        control: Control,
        state: SessionState,
        field: str,
        shown: Callable[[Any], Any],
        chosen: Callable[[Any], Any],
    ) -> None:
        super().__init__(control)
        self._control, self._state, self._field = control, state, field
        self._shown, self._chosen = shown, chosen
        self._showing = False
        self.refresh()
        _changed(control).connect(self._on_set)
        state.settings_changed.connect(self._on_settings)

    def refresh(self) -> None:
        """Show the present choice: the control means something else by it now."""
        self.show(getattr(self._state.settings, self._field))

    def show(self, value: Any) -> None:
        """Show a value, which is not chosen by that."""
        self._showing = True
        _put(self._control, self._shown(value))
        self._showing = False

    def _on_set(self) -> None:
        if not self._showing:
            self._state.change(**{self._field: self._chosen(_get(self._control))})

    def _on_settings(self, names: frozenset[str]) -> None:
        if self._field in names or names & UNIT_CHOICES.keys():
            self.refresh()


def bind(
    control: Control,  # The items of a combo box have the values as their data
    state: SessionState,
    field: str,  # Of `Settings`
    # What the control shows of a value; None leaves a button or a number as it is
    shown: Callable[[Any], Any] = _same,
    chosen: Callable[[Any], Any] = _same,  # Value to choose for what the user has set
) -> Binding:
    """Keep a control and a field of the settings the same."""
    return Binding(control, state, field, shown, chosen)


def bind_member(control: Control, state: SessionState, field: str, name: str) -> None:
    """Have a button or action say whether a name is in a field that is a set."""

    def chosen(on: bool) -> frozenset[str]:
        names: frozenset[str] = getattr(state.settings, field)
        return names | {name} if on else names - {name}

    bind(control, state, field, lambda names: name in names, chosen)


def bind_option(control: Control, state: SessionState, field: str, option: str) -> None:
    """Have one of several exclusive buttons or actions stand for one value of a field."""

    def chosen(on: bool) -> str:
        return option if on else getattr(state.settings, field)

    bind(control, state, field, lambda value: value == option, chosen)


def control(
    state: SessionState,
    field: str,  # Of `Settings`
    info: SettingInfo | None = None,  # Where it is of another setting, which is in the field
    inside: Callable[[Any], Any] = _same,  # That setting of the field's value
    around: Callable[[Any], Any] = _same,  # Value of the field with that setting changed
) -> Any:
    """Control of a setting, as `SettingInfo` describes it, bound to it."""
    info = Settings.info(field) if info is None else info
    box = widget(info)
    is_number = isinstance(box, QSpinBox | QDoubleSpinBox)
    number_for_none = info.low if info.number_for_none is None else info.number_for_none
    optional = getattr(Settings(), field) is None or inside is not _same

    def shown(value: Any) -> Any:
        value = inside(value)
        if info.slider:
            return round(value / info.step)
        if not is_number:
            return value
        unit = _fitted(box, info, state.units)
        return unit.from_si(number_for_none if value is None else value)

    def chosen(value: Any) -> Any:
        if info.slider:
            value *= info.step
        elif is_number:
            value = _unit(info, state.units).to_si(value)
            value = round(value) if isinstance(box, QSpinBox) else value
            value = None if optional and value == number_for_none else value
        return around(value)

    bind(box, state, field, shown, chosen)
    return box


def widget(info: SettingInfo) -> Box:
    """Control of a setting, not bound to it: a choice of titles, a number, or yes and no."""
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


def form(*controls: QWidget) -> QFormLayout:
    """Controls one under the other, each beside its label."""
    rows = QFormLayout()
    for box in controls:
        rows.addRow("" if isinstance(box, QCheckBox) else box.accessibleName(), box)
    return rows


def _unit(info: SettingInfo, units: Units) -> Unit:
    unit: Unit = getattr(units, info.unit) if isinstance(info.unit, str) else info.unit
    return unit


def _fitted(box: Any, info: SettingInfo, units: Units) -> Unit:
    """Give a box of numbers the ends, the step and the unit that it has among the operator's."""
    unit = _unit(info, units)
    if isinstance(box, QDoubleSpinBox):
        box.setDecimals(unit.digits)
    number = float if isinstance(box, QDoubleSpinBox) else round
    box.setRange(number(unit.from_si(info.low)), number(unit.from_si(info.high)))
    box.setSingleStep(number(unit.from_si(info.step)))
    box.setSuffix(f" {unit.symbol}" if unit.symbol else "")
    return unit


def menu_button(state: SessionState, field: str) -> tuple[QToolButton, dict[str, QAction]]:
    """Button with a menu whose actions say which names are in a field that is a set."""
    info, actions = Settings.info(field), dict[str, QAction]()
    button = tool_button(info.label, info.tip)
    button.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
    menu = QMenu(button)
    for name, title in (info.titles or {}).items():
        actions[name] = action = menu.addAction(title)
        action.setCheckable(True)
        bind_member(action, state, field, name)
    button.setMenu(menu)
    return button, actions


def tool_button(text: str, tip: str, *, checkable: bool = False, slim: bool = False) -> QToolButton:
    """Button for a row of them; a slim one has less room around its text."""
    button = QToolButton()
    button.setText(text)
    button.setToolTip(tip)
    button.setCheckable(checkable)
    if slim:
        button.setObjectName("slim")
    return button


def options(box: QComboBox, titles: Mapping[Any, str]) -> QComboBox:
    """Fill a combo box with values by their titles."""
    for value, title in titles.items():
        box.addItem(title, value)
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
    elif value is not None and value != _get(control):  # else what is being typed stays
        control.setChecked(value) if isinstance(control, _SWITCHES) else control.setValue(value)


_SWITCHES = (QAbstractButton, QAction)


# Keys and wheel of a panel's controls.
#
# A control reached by Tab keeps its own keys; else they play and seek. One without the focus leaves
# the wheel to what scrolls the panel: a setting must not change because somebody scrolled past it.


BUTTON_KEYS = frozenset({Qt.Key.Key_Space})
STEPPED = (QAbstractSpinBox, QSlider, QComboBox)
"""Controls whose value the wheel changes."""
SLIDER_KEYS = frozenset({Qt.Key.Key_Left, Qt.Key.Key_Right, Qt.Key.Key_Home, Qt.Key.Key_End})


class ControlInput(QObject):
    """Event filter: focused controls get their keys before shortcuts do, others leave the wheel."""

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Claim the keys that the watched control understands, and refuse a wheel without focus."""
        if event.type() == QEvent.Type.Wheel and isinstance(watched, STEPPED):
            event.setAccepted(watched.hasFocus())
            return not watched.hasFocus()
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            if isinstance(watched, QAbstractSpinBox | QLineEdit):
                return _leaves_to_the_window(event)
            keys = BUTTON_KEYS if isinstance(watched, QAbstractButton) else SLIDER_KEYS
            if event.key() in keys:
                event.accept()
                return True
        return False


def _leaves_to_the_window(event: QKeyEvent) -> bool:
    """Text boxes have an undo of their own, which would hide the window's."""
    undo, redo = QKeySequence.StandardKey.Undo, QKeySequence.StandardKey.Redo
    if event.matches(undo) or event.matches(redo):
        event.ignore()
        return True
    return False


def watch_controls(panel: QWidget) -> None:
    """Let every control of a panel be reached by Tab, and settings be changed on purpose alone.

    Buttons, sliders and settings do not take the focus on a click, number boxes not from the wheel.
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
