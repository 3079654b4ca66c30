"""Messages of the wrench with friction and of slip, as simulated."""

from dataclasses import replace

import numpy as np
import pytest
from wire import STORE

from bubbleviz.live import ResultMessages
from bubbleviz.pipeline import Product
from tests.shear.drag import Eyes, stuck

SHEAR: frozenset[Product] = frozenset({"patch", "traction", "slip"})
SHEAR_TOPICS = {
    "traction_wrench",
    "traction_wrench_sigma",
    "traction_center",
    "slip_share",
    "slip_share_sigma",
}


@pytest.fixture(scope="module")
def eyes():
    return Eyes()


@pytest.fixture(scope="module")
def dragged(eyes):
    """The second frame of a puck at rest after it was dragged."""
    truth = stuck("puck", 0.004, 0.001, 8.0)
    first, second = (eyes.pipeline.process(eyes.see(truth, seed), SHEAR) for seed in range(2))
    assert first.slip is None and second.slip is not None
    return second


def messages(eyes, result):
    """Messages of a result by the last part of their topic."""
    return {
        each.topic.rsplit("/", 1)[1]: STORE.deserialize_cdr(each.payload, each.type)
        for each in ResultMessages(eyes.pipeline.mesh).of(result)
    }


def vector(of):
    return np.array([of.x, of.y, of.z])


def test_messages_have_wrench_and_slip(eyes, dragged):
    truth, got = stuck("puck", 0.004, 0.001, 8.0), messages(eyes, dragged)
    assert got.keys() >= SHEAR_TOPICS
    wrench, size = got["traction_wrench"].wrench, np.linalg.norm(truth.force_n)
    np.testing.assert_allclose(vector(wrench.force), truth.force_n, atol=0.05 * size)
    centre = vector(got["traction_center"].point)
    expected = dragged.patch.torque_nm + np.cross(centre, vector(wrench.force))
    np.testing.assert_allclose(vector(wrench.torque), expected, atol=1e-12)
    for name in ("wrench", "wrench_sigma"):  # a frame has one force, colour or not
        assert got[f"traction_{name}"] == got[f"contact_{name}"]
    assert 0.0 < vector(got["traction_wrench_sigma"].wrench.force).max() < 0.1 * size
    assert got["slip_share"].data == 0.0  # all of it sticks
    assert got["slip_share_sigma"].data == pytest.approx(dragged.slip.share_sigma)


def test_unknown_results_are_not_published(eyes, dragged):
    assert messages(eyes, replace(dragged, slip=None)).keys() & SHEAR_TOPICS == {
        "traction_wrench",
        "traction_wrench_sigma",
        "traction_center",
    }
    alone = replace(dragged.traction, status="depth_alone")
    doubtful = replace(dragged.estimate, status="implausible")
    for result in (
        replace(dragged, traction=None, slip=None),
        replace(dragged, traction=alone),
        replace(dragged, estimate=doubtful),
    ):
        assert not messages(eyes, result).keys() & SHEAR_TOPICS


def test_without_contact_the_wrench_is_zero(eyes):
    result = eyes.pipeline.process(eyes.rest(), SHEAR)
    assert result.traction.status == "no_contact"
    assert messages(eyes, result).keys() & SHEAR_TOPICS == {"traction_wrench"}
    wrench = messages(eyes, result)["traction_wrench"].wrench
    assert not vector(wrench.force).any() and not vector(wrench.torque).any()
