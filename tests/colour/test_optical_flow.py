"""Optical flow of a known texture: motion, its uncertainty, and exclusion of covered pixels."""

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.recordings import Recording
from bubbleviz.shear import OpticalFlow
from tests.colour.speckle import HEIGHT, WIDTH, at_rest, camera, clean_image, dragged, grid, twisted

pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")


@pytest.fixture(scope="module")
def rest():
    return at_rest()


def errors_px(field, motion):
    y, x = np.divmod(field.pixel, WIDTH)
    return field.moved_px - np.stack(motion(x.astype(float), y.astype(float)), axis=1)


@pytest.mark.parametrize("motion", [dragged, twisted])
def test_motion_and_its_sigma_are_correct(rest, motion):
    """The brightness changes by a fifth across the image, as when the membrane tilts."""
    flow = OpticalFlow.of(rest)
    lit = 0.9 + 0.2 * grid()[0] / WIDTH
    field = flow.measure(camera(lit * clean_image(motion), 99))
    assert not field.problem
    assert len(field.pixel) > 0.9 * (HEIGHT // 8) * (WIDTH // 8)
    errors = errors_px(field, motion)
    inside = np.hypot(*motion(*grid())).ravel()[field.pixel] > 1.0
    assert np.sqrt(np.mean(errors[inside] ** 2)) < 0.3
    z = errors / field.sigma_px[:, None]
    assert 0.4 < np.sqrt(np.mean(z[inside] ** 2)) < 1.6
    assert np.mean(np.abs(z) > 4.0) < 0.03


def poked(x, y):
    """9 pixels at a contact that is 40 pixels wide."""
    near = np.exp(-((x - 150.0) ** 2 + (y - 120.0) ** 2) / (2.0 * 20.0**2))
    return 6.4 * near, -6.4 * near


def test_motion_of_a_small_contact_is_not_averaged_out(rest):
    field = OpticalFlow.of(rest).measure(camera(clean_image(poked), 99))
    y, x = np.divmod(field.pixel, WIDTH)
    middle = np.hypot(x - 150, y - 120) < 10
    moved, true = field.moved_px[middle], np.stack(poked(x, y), axis=1)[middle]
    np.testing.assert_allclose(moved.mean(axis=0), true.mean(axis=0), rtol=0.06)


def test_a_membrane_at_rest_does_not_move(rest):
    flow = OpticalFlow.of(rest)
    field = flow.measure(camera(clean_image(), 99))
    assert np.sqrt(np.mean(field.moved_px**2)) < 0.03
    assert np.median(field.sigma_px) < 0.05
    assert np.mean(np.abs(field.moved_px) < 3.0 * field.sigma_px[:, None]) > 0.99
    np.testing.assert_array_equal(field.pixel, np.sort(field.pixel))


def test_noisier_images_have_larger_sigma():
    clean = clean_image()
    rng = np.random.default_rng(1)
    noisy = [camera(clean + rng.normal(0.0, 8.0, clean.shape), k) for k in range(12)]
    quiet, loud = OpticalFlow.of(at_rest()), OpticalFlow.of(noisy)
    both = np.intersect1d(quiet.pixel, loud.pixel)
    ratio = loud.noise_px[np.isin(loud.pixel, both)] / quiet.noise_px[np.isin(quiet.pixel, both)]
    assert 2.5 < np.median(ratio) < 6.0  # σ is 8.2 in place of 2 grey levels


def test_pixels_without_texture_or_saturated_are_excluded():
    clean = clean_image()
    clean[:, :100] = 90.0
    clean[:100, 220:] += 160.0
    flow = OpticalFlow.of([camera(clean, k) for k in range(12)])
    y, x = np.divmod(flow.measure(camera(clean, 50)).pixel, WIDTH)
    assert not np.any(x < 90)
    assert np.mean((y < 90) & (x > 230)) < 0.05
    assert np.mean((y > 110) & (x > 110)) > 0.5


def test_covered_or_glaring_pixels_are_excluded(rest):
    """The image there differs from that at rest."""
    flow = OpticalFlow.of(rest)
    image = clean_image()
    image[50:130, 40:140] = clean_image()[::-1, ::-1][50:130, 40:140]
    image[150:220, 200:280] = 255.0
    field = flow.measure(camera(image, 77))
    y, x = np.divmod(field.pixel, WIDTH)
    covered = (y > 60) & (y < 120) & (x > 50) & (x < 130)
    wrong = np.abs(field.moved_px[covered]).max(axis=1) > 4.0 * field.sigma_px[covered]
    assert np.count_nonzero(wrong) < 0.2 * 80
    assert not np.any((y > 155) & (y < 215) & (x > 205) & (x < 275))


def test_pixels_outside_the_mask_are_excluded(rest):
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[40:200, 60:260] = True
    assert mask.ravel()[OpticalFlow.of(rest, mask=mask).pixel].all()


@pytest.mark.parametrize(("level", "why"), [(100.0, "no texture"), (400.0, "over-exposed")])
def test_useless_images_give_a_reason(level, why):
    blank = np.full((HEIGHT, WIDTH), level)
    flow = OpticalFlow.of([camera(blank, k) for k in range(6)])
    assert why in flow.problem
    field = flow.measure(camera(blank, 9))
    assert (len(field.pixel), field.problem) == (0, flow.problem)


def test_another_scene_is_reported(rest):
    field = OpticalFlow.of(rest).measure(camera(clean_image()[::-1, ::-1], 3))
    assert "could not be matched" in field.problem


def test_bad_input_gives_one_sentence(rest):
    with pytest.raises(InputError, match="give at least 5"):
        OpticalFlow.of(rest[:4])
    with pytest.raises(InputError, match="sizes differ"):
        OpticalFlow.of([*rest, rest[0][1:]])
    with pytest.raises(InputError, match="320×239 pixels, the contact-free ones have 320×240"):
        OpticalFlow.of(rest).measure(rest[0][1:])


def test_the_real_press(punyo_press_colour):
    """A poker presses 5.6 mm deep: up to 17 pixels; nothing moves before."""
    with Recording(punyo_press_colour) as recording:
        images = [recording[k].colour for k in (*range(45, 60), 80)]
        greys = [image.grey() for image in images if image is not None]
    flow = OpticalFlow.of(greys[:12])
    assert 0.005 < np.median(flow.noise_px) < 0.04
    assert not flow.problem
    untouched, pressed = flow.measure(greys[13]), flow.measure(greys[15])
    assert np.sqrt(np.mean(untouched.moved_px**2)) < 0.03
    assert len(pressed.pixel) > 0.9 * len(flow.pixel)
    assert 12.0 < np.linalg.norm(pressed.moved_px, axis=1).max() < 20.0
