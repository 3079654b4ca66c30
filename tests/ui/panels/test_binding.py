"""A bound control shows its choice and chooses what the user sets, once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from PySide6.QtGui import QAction
from PySide6.QtWidgets import QCheckBox, QComboBox, QDoubleSpinBox, QSlider
from pytestqt.qtbot import QtBot

from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.panels.binding import bind, bind_member, bind_option, bind_quantity, options


@pytest.fixture
def state(qtbot: QtBot) -> Iterator[SessionState]:
    yield SessionState()


def told(state: SessionState) -> list[frozenset[str]]:
    names: list[frozenset[str]] = []
    state.choices_changed.connect(names.append)
    return names


def test_slider_and_box_of_one_choice_follow_each_other(qtbot: QtBot, state: SessionState) -> None:
    slider, box = QSlider(), QDoubleSpinBox()
    qtbot.addWidget(slider)
    qtbot.addWidget(box)
    bind(slider, state, "membrane_opacity", lambda v: round(100 * v), lambda v: v / 100)
    bind(box, state, "membrane_opacity")
    heard = told(state)
    slider.setValue(40)
    assert state.choices.membrane_opacity == 0.4 and box.value() == 0.4
    box.setValue(0.7)
    assert slider.value() == 70
    state.choose(membrane_opacity=0.2)
    assert (slider.value(), box.value()) == (20, 0.2)
    assert heard == [frozenset({"membrane_opacity"})] * 3


def test_a_value_that_is_only_shown_is_not_chosen(qtbot: QtBot, state: SessionState) -> None:
    box = QDoubleSpinBox()
    qtbot.addWidget(box)
    bound = bind(box, state, "kappa")
    bound.show(4.5)
    assert box.value() == 4.5 and state.choices.kappa is None
    state.choose(kappa=3.0)
    state.choose(kappa=None)
    assert box.value() == 3.0  # a number cannot show None


def test_a_combo_box_has_values_as_data(qtbot: QtBot, state: SessionState) -> None:
    box = options(QComboBox(), {None: "whole", "x": "cut"})
    qtbot.addWidget(box)
    bind(box, state, "section_axis")
    assert box.currentText() == "whole"
    box.setCurrentIndex(1)
    assert state.choices.section_axis == "x"
    state.choose(section_axis=None)
    assert box.currentIndex() == 0


def test_members_and_options(qtbot: QtBot, state: SessionState) -> None:
    rim, light = QCheckBox(), QAction(checkable=True)
    qtbot.addWidget(rim)
    bind_member(rim, state, "layers", "rim")
    bind_option(light, state, "theme", "light")
    assert rim.isChecked() and not light.isChecked()
    others = state.choices.layers - {"rim"}
    rim.click()
    assert state.choices.layers == others
    light.trigger()
    assert state.choices.theme == "light"
    state.choose(theme="dark")
    assert not light.isChecked()


def test_a_quantity_is_shown_in_the_unit_of_now_and_chosen_in_si(
    qtbot: QtBot, state: SessionState
) -> None:
    box = QDoubleSpinBox()
    qtbot.addWidget(box)
    bind_quantity(box, state, "pressure_max_pa", lambda u: u.pressure, 1e6, 1e3)
    box.setValue(2.5)
    assert state.choices.pressure_max_pa == pytest.approx(2500.0)
    heard = told(state)
    state.choose(pressure_unit="Pa")
    assert box.value() == 2500.0 and box.suffix() == " Pa"
    assert heard == [frozenset({"pressure_unit"})]
    box.setValue(0.0)
    assert state.choices.pressure_max_pa is None
