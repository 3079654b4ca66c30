"""The pipeline runs only the stages of the requested products."""

import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from bubbleviz.camera import FlowField
from bubbleviz.errors import InputError
from bubbleviz.inverse import ContactProblem
from bubbleviz.pipeline import FrameOptions, Pipeline, Product
from bubbleviz.recordings import Frame

sys.path.insert(0, str(Path(__file__).parent / "ui"))
from fakes import FRAMES, DentSource, small_sensor

FREE, PRESSED = 0, FRAMES - 1


@pytest.fixture(scope="module")
def source():
    return DentSource(small_sensor())


@pytest.fixture
def pipeline():
    return Pipeline.of(small_sensor())


def made(result):
    """Names of the fields of a result that hold something."""
    values = {f.name: getattr(result, f.name) for f in fields(result)}
    return {name for name, value in values.items() if value is not None} - {"frame", "times_ms"}


@pytest.mark.parametrize(
    ("products", "stages", "holds"),
    [
        ((), set(), set()),
        (("cloud",), {"cloud"}, {"cloud_m", "cloud_pixels"}),
        (("estimate",), {"estimate"}, {"estimate"}),
        (("patch",), {"estimate", "fine_contact", "patch"}, {"estimate", "patch"}),
        (
            ("pixel_mask",),
            {"estimate", "fine_contact", "patch", "pixel_mask"},
            {"estimate", "patch"},
        ),
        (
            ("residual",),
            {"estimate", "cloud", "residual"},
            {"estimate", "cloud_m", "cloud_pixels", "cloud_residual_m"},
        ),
        (
            ("patch", "cloud"),
            {"estimate", "fine_contact", "patch", "cloud"},
            {"estimate", "patch", "cloud_m", "cloud_pixels"},
        ),
    ],
)
def test_products_run_the_stages_they_need_and_no_other(pipeline, source, products, stages, holds):
    result = pipeline.process(source[PRESSED], frozenset(products))
    assert dict(pipeline.counts) == dict.fromkeys(stages | {"total"}, 1)
    assert set(result.times_ms) == stages | {"total"}
    assert made(result) == holds
    if result.patch is not None:
        assert (result.patch.pixel_mask is not None) == ("pixel_mask" in products)


def test_a_pipeline_without_requested_estimates_builds_no_solver(pipeline, source, monkeypatch):
    monkeypatch.setattr("bubbleviz.pipeline.Estimator", lambda *_: pytest.fail("built"))
    result = pipeline.process(source[PRESSED], frozenset({"cloud"}))
    assert result.cloud_m is not None
    assert len(result.cloud_m) == np.isfinite(source[PRESSED].depth_m).sum()


@pytest.mark.parametrize("most", [50, 90, 130, 333, 700])
def test_a_smaller_cloud_is_spread_evenly(pipeline, source, most):
    frame = source[PRESSED]
    result = pipeline.process(frame, frozenset({"cloud"}), FrameOptions(cloud_points=most))
    assert result.cloud_pixels is not None and len(result.cloud_pixels) <= most
    left_out = np.ones(frame.depth_m.shape, bool)
    left_out.ravel()[result.cloud_pixels] = False
    seen = np.isfinite(frame.depth_m)
    period = np.ceil(seen.sum() / most)
    assert distance_transform_edt(left_out)[seen].max() <= 1.5 * np.sqrt(period) + 1.0


def test_kappa_thresholds_again_without_solving(pipeline, source):
    estimate = pipeline.process(source[PRESSED], frozenset({"patch"})).estimate
    assert estimate is not None
    low, middle, high = (
        pipeline.patch(estimate, FrameOptions(kappa)) for kappa in (0.5, 5.0, 20.0)
    )
    assert low.area_m2 > middle.area_m2 > high.area_m2
    assert high.threshold_pa == pytest.approx(40.0 * low.threshold_pa)
    np.testing.assert_array_equal(low.force_n, high.force_n)
    assert pipeline.counts["estimate"] == 1


def test_a_contact_free_frame_solves_no_qp(pipeline, source, monkeypatch):
    """No contact, no QP: its solver is not even called."""
    calls = []
    select = ContactProblem.select
    monkeypatch.setattr(ContactProblem, "select", lambda *a: (calls.append(1), select(*a))[1])
    free = pipeline.process(source[FREE], frozenset({"patch"}))
    assert free.estimate.status == "no_contact"
    assert not calls
    pressed = pipeline.process(source[PRESSED], frozenset({"patch"}))
    assert pressed.estimate.contact_pressure_pa.any()
    assert calls  # else the test looks at the wrong solver


def test_an_empty_frame_between_presses(pipeline, source):
    first = pipeline.process(source[PRESSED], frozenset({"patch"}))
    nothing = Frame(1, 0.0, np.full_like(source[PRESSED].depth_m, np.nan))
    empty = pipeline.process(nothing, frozenset({"pixel_mask", "residual"}))
    assert empty.estimate.status == "no_data"
    again = pipeline.process(source[PRESSED], frozenset({"patch"}))
    np.testing.assert_allclose(again.patch.force_n, first.patch.force_n, rtol=0.02, atol=0.02)


def test_separate_estimate_does_not_change_the_next_frame(pipeline, source):
    wanted: frozenset[Product] = frozenset({"estimate"})

    def solved(index):
        return pipeline.process(source[index], wanted).estimate

    first, then = solved(PRESSED - 1), solved(PRESSED)
    pipeline.restart()
    again = solved(PRESSED - 1)
    np.testing.assert_array_equal(again.displacement_m, first.displacement_m)
    aside = pipeline.estimate_once(source[FREE])
    assert aside.status == "no_contact"
    repeated = solved(PRESSED)
    np.testing.assert_array_equal(repeated.displacement_m, then.displacement_m)
    assert repeated.iterations == then.iterations
    pipeline.restart()
    assert np.any(solved(PRESSED).displacement_m != then.displacement_m)  # else it is not warm


def test_another_image_size_is_refused(pipeline):
    frame = Frame(3, 0.0, np.full((10, 20), 0.1, np.float32))
    with pytest.raises(InputError, match=r"frame 3: image is 20×10 pixels .* 80×60"):
        pipeline.process(frame, frozenset({"estimate"}))
    assert not pipeline.counts


def test_flow_that_saw_nothing_leaves_the_estimate_as_it_is(pipeline, source):
    nothing = FlowField(np.zeros(0, int), np.zeros((0, 2)), np.zeros(0), (2, 2), "no texture")
    alone = pipeline.process(source[PRESSED], frozenset({"estimate"})).estimate
    pipeline.restart()
    pipeline.use_optical_flow(lambda _: nothing)
    wanted = frozenset[Product]({"estimate", "flow"})
    result = pipeline.process(source[PRESSED], wanted)
    assert result.flow is nothing
    np.testing.assert_array_equal(result.estimate.force_n, alone.force_n)
    assert set(result.times_ms) == wanted | {"total"}


def test_errors_of_the_flow_are_raised(pipeline, source):
    def flow_of(_):
        raise InputError("colour image: cannot be decoded")

    pipeline.use_optical_flow(flow_of)
    with pytest.raises(InputError, match="cannot be decoded"):
        pipeline.process(source[PRESSED], frozenset({"estimate", "flow"}))
