"""Controls of settings: made from what `Choices` says of each, and bound to it."""

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

from bubbleviz_ui.model.choices import About, Choices
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.units import SYSTEMS, Unit, Units

Box = QAbstractButton | QAbstractSlider | QSpinBox | QDoubleSpinBox | QComboBox
Control = Box | QAction


def _same(value: Any) -> Any:
    return value


class Binding(QObject):
    """A control and its field of the choices, see `bind`; it lives as long as the control."""

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
        state.choices_changed.connect(self._on_choices)

    def refresh(self) -> None:
        """Show the present choice: the control means something else by it now."""
        self.show(getattr(self._state.choices, self._field))

    def show(self, value: Any) -> None:
        """Show a value, which is not chosen by that."""
        self._showing = True
        _put(self._control, self._shown(value))
        self._showing = False

    def _on_set(self) -> None:
        if not self._showing:
            self._state.choose(**{self._field: self._chosen(_get(self._control))})

    def _on_choices(self, names: frozenset[str]) -> None:
        if self._field in names or names & SYSTEMS.keys():
            self.refresh()


def bind(
    control: Control,  # The items of a combo box have the values as their data
    state: SessionState,
    field: str,  # Of `Choices`
    # What the control shows of a value; None leaves a button or a number as it is
    shown: Callable[[Any], Any] = _same,
    chosen: Callable[[Any], Any] = _same,  # Value to choose for what the user has set
) -> Binding:
    """Keep a control and a field of the choices the same."""
    return Binding(control, state, field, shown, chosen)


def bind_member(control: Control, state: SessionState, field: str, name: str) -> None:
    """Have a button or action say whether a name is in a field that is a set."""

    def chosen(on: bool) -> frozenset[str]:
        names: frozenset[str] = getattr(state.choices, field)
        return names | {name} if on else names - {name}

    bind(control, state, field, lambda names: name in names, chosen)


def bind_option(control: Control, state: SessionState, field: str, option: str) -> None:
    """Have one of several exclusive buttons or actions stand for one value of a field."""

    def chosen(on: bool) -> str:
        return option if on else getattr(state.choices, field)

    bind(control, state, field, lambda value: value == option, chosen)


def control(
    state: SessionState,
    field: str,  # Of `Choices`
    about: About | None = None,  # Where it is of another setting, which is in the field
    inside: Callable[[Any], Any] = _same,  # That setting of the field's value
    around: Callable[[Any], Any] = _same,  # Value of the field with that setting changed
) -> Any:
    """Control of a setting, as `About` describes it, bound to it."""
    about = Choices.about(field) if about is None else about
    box = widget(about)
    is_number = isinstance(box, QSpinBox | QDoubleSpinBox)
    usual = about.low if about.usual is None else about.usual
    optional = getattr(Choices(), field) is None or inside is not _same

    def shown(value: Any) -> Any:
        value = inside(value)
        if about.slider:
            return round(value / about.step)
        if not is_number:
            return value
        unit = _fitted(box, about, state.units)
        return unit.of(usual if value is None else value)

    def chosen(value: Any) -> Any:
        if about.slider:
            value *= about.step
        elif is_number:
            value = _unit(about, state.units).to_si(value)
            value = round(value) if isinstance(box, QSpinBox) else value
            value = None if optional and value == usual else value
        return around(value)

    bind(box, state, field, shown, chosen)
    return box


def widget(about: About) -> Box:
    """Control of a setting, not bound to it: a choice of titles, a number, or yes and no."""
    box: Box
    if about.titles is not None:
        box = options(QComboBox(), about.titles)
    elif about.slider:
        box = QSlider(Qt.Orientation.Horizontal)
        box.setRange(round(about.low / about.step), round(about.high / about.step))
    elif about.high > about.low:
        box = QSpinBox() if isinstance(about.low, int) else QDoubleSpinBox()
        box.setSpecialValueText(about.lowest)
        box.setKeyboardTracking(False)
    else:
        box = QCheckBox(about.label)
    box.setToolTip(about.tip)
    box.setAccessibleName(about.label)
    return box


def form(*controls: QWidget) -> QFormLayout:
    """Controls one under the other, each beside its label."""
    rows = QFormLayout()
    for box in controls:
        rows.addRow("" if isinstance(box, QCheckBox) else box.accessibleName(), box)
    return rows


def _unit(about: About, units: Units) -> Unit:
    unit: Unit = getattr(units, about.unit) if isinstance(about.unit, str) else about.unit
    return unit


def _fitted(box: Any, about: About, units: Units) -> Unit:
    """Give a box of numbers the ends, the step and the unit that it has among the operator's."""
    unit = _unit(about, units)
    if isinstance(box, QDoubleSpinBox):
        box.setDecimals(unit.digits)
    number = float if isinstance(box, QDoubleSpinBox) else round
    box.setRange(number(unit.of(about.low)), number(unit.of(about.high)))
    box.setSingleStep(number(unit.of(about.step)))
    box.setSuffix(f" {unit.symbol}" if unit.symbol else "")
    return unit


def menu_button(state: SessionState, field: str) -> tuple[QToolButton, dict[str, QAction]]:
    """Button with a menu whose actions say which names are in a field that is a set."""
    about, actions = Choices.about(field), dict[str, QAction]()
    button = tool_button(about.label, about.tip)
    button.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
    menu = QMenu(button)
    for name, title in (about.titles or {}).items():
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

    Buttons, sliders and choices do not take the focus on a click, number boxes not from the wheel.
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
