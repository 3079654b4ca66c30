"""Compare panel: numbers and outlines of two settings, and use of one of them."""

import numpy as np
import pytest
from fakes import DentSource, small_sensor
from live_bench import connected_bench
from window_driver import CONTACT, view_texts

from bubbleviz.inverse import EstimatorOptions
from bubbleviz_ui.model.settings import ComparedSetting, Settings
from bubbleviz_ui.model.source_facts import force_text
from bubbleviz_ui.shell import theme

PRESSED = 8


@pytest.fixture(scope="session")
def sensor():
    """A coarse one: the panel shows what is known of a frame, whatever the mesh."""
    return small_sensor(nodes=80)


def outlines(driver):
    """Number of pixels of the outlines of A and B in the 3-D view."""
    return driver.count(*theme.COMPARED)


def text(driver, row, *, of_b=False):
    panel = driver.window.compare
    return (panel.b if of_b else panel.a).values[row].text()


def wait_until_as_shown(driver):
    """Wait until the numbers of A, the window's own setting, equal those of the window."""

    def as_shown():
        result, units = driver.result, driver.state.units
        force = force_text(result, units)
        shown = (f"{result.frame.index}", force, units.area.text(result.patch.area_m2))
        compared = tuple(text(driver, row) for row in ("frame", "force", "area"))
        return driver.window.controller.cold_solved and compared == shown

    driver.wait(as_shown)


def test_compared_outlines_belong_to_their_frame_and_a_setting_can_be_used(drive, monkeypatch):
    driver = drive(DentSource, frame=PRESSED)
    controller, dock = driver.window.controller, driver.window.panels["compare"]
    a, b = ComparedSetting(solver="linear", kappa=1.0), ComparedSetting(solver="linear", kappa=20.0)
    driver.choose(layers=frozenset({"membrane", "compared"}), compared=(a, b))
    assert outlines(driver) == [0, 0]
    # in the smallest window all results are visible
    assert driver.size == (1024, 700) and driver.window.panels["layers"].isVisible()
    dock.show()
    assert text(driver, "status") == "solving …"
    columns = driver.window.compare.a, driver.window.compare.b
    labels = [label for column in columns for label in column.values.values()]
    driver.wait(lambda: all(at.visibleRegion().boundingRect().size() == at.size() for at in labels))
    driver.wait(lambda: min(outlines(driver)) > 20)
    assert outlines(driver)[0] > 1.1 * outlines(driver)[1]  # A's patch is the larger one
    areas, residuals = (
        [float(text(driver, row, of_b=of_b).split()[0]) for of_b in (False, True)]
        for row in ("area", "residual")
    )
    assert areas[0] > 1.2 * areas[1] and residuals[0] == pytest.approx(residuals[1], rel=0.02)
    for shown in (False, True):
        driver.click(driver.window.compare.outlines)
        assert (min(outlines(driver)) > 20) == (max(outlines(driver)) > 0) == shown
    driver.state.seek(9)
    assert outlines(driver) == [0, 0]
    driver.wait(lambda: text(driver, "frame") == "9")
    assert min(outlines(driver)) > 20
    stale: list[bool] = []

    def look(result):
        if text(driver, "frame") not in ("–", f"{result.frame.index}"):
            stale.append(outlines(driver) != [0, 0])

    shown = controller.shown.connect(look)
    driver.state.set_playing(True)
    driver.wait(lambda: len(stale) > 3)
    driver.state.set_playing(False)
    controller.shown.disconnect(shown)
    assert not any(stale)
    driver.seek(9)
    driver.wait_until_shown()
    driver.state.change(compared=(a, ComparedSetting(solver="no such")))
    assert outlines(driver) == [0, 0]
    driver.wait(lambda: text(driver, "status", of_b=True) == "impossible")
    assert outlines(driver)[0] > 20 and outlines(driver)[1] == 0
    driver.state.seek(0)
    assert text(driver, "status") == "solving …" and text(driver, "force") == "–"
    driver.wait(lambda: text(driver, "status") == "no contact")
    assert outlines(driver) == [0, 0]
    driver.seek(9)
    driver.wait(lambda: outlines(driver)[0] > 20)
    dock.hide()
    assert outlines(driver) == [0, 0]
    # the solver is free while the panel is opened and while scrubbing
    with monkeypatch.context() as patch:
        patch.setattr("bubbleviz_ui.engine.controller.COLD_SOLVE_DELAY_MS", 1e6)
        dock.show()
        for frame in (7, 8, 9):
            driver.pass_by([frame])
            driver.wait_for_redraw()
            assert text(driver, "status") == "solving …"
    dock.hide()
    # a setting is used everywhere, and that is undone
    window, panel, state = driver.window, driver.window.compare, driver.state
    dock.show()
    state.change(
        compared=(ComparedSetting(), ComparedSetting(solver="linear", nodes=300, kappa=2.5))
    )
    driver.click(panel.b.used)
    driver.wait(lambda: driver.pipeline.options.nodes == 300)
    driver.wait_until_shown()
    assert driver.pipeline.options.solver == "linear" and state.settings.kappa == 2.5
    assert window.kappa.solver.currentText() == "setting B of Compare"
    panel.b.controls["block"].setValue(2)  # of what is in use
    driver.wait(lambda: driver.pipeline.options.block == 2)
    current = driver.solver.current
    panel.a.controls["block"].setValue(3)  # of what is not
    driver.wait_until_shown()
    assert driver.solver.current is current
    driver.type(panel.b.controls["kappa"], "4.5")
    driver.wait(driver.shows_chosen_kappa)
    assert state.settings.kappa == window.kappa.box.value() == 4.5
    panel.a.controls["kappa"].setValue(7.0)
    assert state.settings.kappa == 4.5
    for _ in range(2):
        window.undo_stack.undo()
    assert state.settings.kappa == panel.b.controls["kappa"].value() == 2.5
    for _ in range(3):
        window.undo_stack.undo()
    driver.wait(lambda: driver.pipeline.options.solver is None)
    driver.wait_until_shown()
    assert state.settings.kappa is None and state.settings.solver is None


def test_current_setting_measures_what_the_window_shows_with_its_friction(drive):
    driver = drive(frame=CONTACT)
    driver.show("compare")
    driver.state.change(compared=(ComparedSetting(), ComparedSetting(solver="linear", nodes=100)))
    wait_until_as_shown(driver)
    for frame in (CONTACT - 15, CONTACT):  # with different warm starts
        driver.seek(frame)
        wait_until_as_shown(driver)
    driver.state.change(least_area_m2=1.0)
    driver.wait(lambda: driver.result.patch.area_m2 == 0.0)
    driver.wait(lambda: text(driver, "area").startswith("0 "))
    # the panel shows the frame of the numbers
    driver.state.seek(2)
    assert {text(driver, row) for row in ("frame", "force")} == {"–"}
    named: list[tuple[str, int]] = []
    compared = driver.window.controller.compared
    naming = compared.connect(
        lambda _, new: named.append((text(driver, "frame"), new[0].result.frame.index))
    )
    driver.state.set_playing(True)
    driver.wait(lambda: len(named) > 2)
    driver.state.set_playing(False)
    driver.wait_until_shown()
    driver.wait(lambda: text(driver, "frame") == f"{driver.state.frame}")
    compared.disconnect(naming)
    assert all(text == f"{index}" for text, index in named)
    # friction of the friction setting is shown everywhere
    window, panel = driver.window, driver.window.compare
    driver.choose(compared=Settings().compared, least_area_m2=Settings().least_area_m2)
    window.undo_stack.clear()
    driver.show_source(DentSource, small_sensor(prestretch=1.3), frame=6)

    def shown_friction():
        """Check the friction shown by the window."""
        said = " ".join(view_texts(driver))  # in the view nothing is said of what is not known
        shown = said.split("friction ")[1].split("   ")[0] if "friction" in said else "–"
        part = window.status.labels["force"].toolTip().split("by friction: ")[1]
        assert part.removesuffix(" (friction was not estimated)") == shown
        return shown

    estimate = driver.result.estimate
    part_n = estimate.friction_n.sum(axis=0)
    friction, own = np.linalg.norm(part_n), part_n / np.linalg.norm(part_n)
    half_width = 1.96 * np.sqrt(own @ estimate.wrench_covariance[:3, :3] @ own)
    assert friction > 0.05
    shown, _, half = shown_friction().removesuffix(" N").partition(" ± ")
    assert float(shown) == pytest.approx(friction, abs=0.006)
    assert float(half) == pytest.approx(half_width, abs=0.006)
    driver.wait(lambda: text(driver, "friction") == f"{shown} ± {half} N")
    driver.choose(force_unit="mN")
    assert shown_friction() == text(driver, "friction")
    values = [float(each) for each in shown_friction().removesuffix(" mN").split(" ± ")]
    assert values == pytest.approx([1e3 * friction, 1e3 * half_width], abs=6.0)
    driver.choose(force_unit="N")
    assert text(driver, "friction", of_b=True) == "–"  # none in the linear model

    driver.type(panel.a.controls["friction"], "0")
    assert panel.a.controls["friction"].text() == "none"
    driver.wait(lambda: text(driver, "friction") == "–")
    driver.click(panel.a.used)
    driver.wait(lambda: driver.pipeline.options.friction == 0.0)
    driver.wait_until_shown()
    estimate = driver.result.estimate
    assert not estimate.friction_n.any() and np.linalg.norm(estimate.force_n) > 0.1
    assert shown_friction() == "–"
    for _ in range(2):
        window.undo_stack.undo()
    driver.wait(lambda: driver.solver.current is not None)  # None while it is built
    driver.wait(lambda: driver.pipeline.options.friction == EstimatorOptions().friction)
    driver.wait_until_shown()
    driver.wait(lambda: shown_friction() == f"{shown} ± {half} N")
    driver.seek(0)
    assert window.status.labels["force"].toolTip().endswith("by friction: 0.00 N")


def test_live_frame_is_compared_with_zeroed_gas_pressure(open_bench):
    live = connected_bench(open_bench)
    live.learn_zero(shift_pa=100.0)
    live.show("compare")
    live.wait_for_frames()
    live.wait(lambda: live.result.patch.area_m2 > 0.0)
    live.state.freeze(True)
    live.wait_until_shown()
    wait_until_as_shown(live)
