"""Ray casting, the operators S and D, and block residuals, against geometry."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.camera import (
    BlockSquares,
    DepthCamera,
    MembraneView,
    PixelModel,
    RangeObserver,
    RayCaster,
    facet_error,
)
from bubbleviz.errors import InputError
from bubbleviz.membrane import build_mesh
from bubbleviz.sensor import load_sensor

SENSOR = load_sensor("pico_flexx_75mm")
MESH = build_mesh(SENSOR, 600)
CAMERA = DepthCamera.of(SENSOR.camera)


def smooth_dent(amplitude_m):
    """Displacement of a smooth dent off the apex, 0 on the rim."""
    x, y, _ = MESH.nodes.T
    bump = np.exp(-((x - 0.012) ** 2 + (y + 0.006) ** 2) / 0.02**2)
    return np.where(MESH.rim, 0.0, -amplitude_m * bump)


def at(observer, displacement):
    """Model of the block residuals at a displacement."""
    return observer.around(MESH.deformed(displacement)).model_m


CASTER = RayCaster(CAMERA.center, CAMERA.directions, MESH.triangles)


def cast(displacement):
    return CASTER.cast(MESH.deformed(displacement))


def test_rays_hit_the_sphere_at_the_analytic_points():
    radius = (0.075**2 + 0.05**2) / (2 * 0.05)
    hits = cast(np.zeros(len(MESH.nodes)))
    assert len(hits.ray) > 0.99 * 224 * 171
    points = CAMERA.center + hits.range_m[:, None] * CAMERA.directions[hits.ray]
    distance = np.linalg.norm(points - [0, 0, 0.05 - radius], axis=1)
    sagitta = MESH.edge_length**2 / (3 * radius)  # facets lie inside the sphere by no more
    assert np.all(distance <= radius + 1e-6)
    assert np.all(distance >= radius - 1.5 * sagitta)
    assert facet_error(MESH) == pytest.approx(MESH.edge_length**2 / (8 * radius), rel=0.3)


@pytest.mark.parametrize("depth_m", [0.0, 0.004, 0.012])
def test_walking_and_ray_casting_find_the_same_triangles(depth_m):
    """After a motion of a share of an edge, and from one triangle to the next but one."""
    old = cast(smooth_dent(depth_m))
    nodes = MESH.deformed(smooth_dent(depth_m + 0.5 * MESH.edge_length))
    fresh, walked = CASTER.cast(nodes), CASTER.recast(nodes, old)
    both, a, b = np.intersect1d(fresh.ray, walked.ray, return_indices=True)
    assert len(both) > 0.999 * len(fresh.ray)
    assert np.mean(fresh.triangle[a] != old.triangle[b]) > 0.002  # or there was nothing to walk
    assert np.mean(fresh.triangle[a] != walked.triangle[b]) < 1e-3  # rays along an edge
    assert np.max(np.abs(fresh.range_m[a] - walked.range_m[b])) < 1e-5


def test_the_operators_reproduce_points_and_differences():
    base = smooth_dent(0.01)
    hits = cast(base)
    corners = MESH.triangles[hits.triangle]

    def interpolated(field):
        return np.einsum("ij,ij...->i...", hits.barycentric, field[corners])

    points = CAMERA.center + hits.range_m[:, None] * CAMERA.directions[hits.ray]
    assert interpolated(MESH.deformed(base)) == pytest.approx(points, abs=1e-6)
    D = CASTER.jacobian(MESH.deformed(base), hits, MESH.normals)
    rng = np.random.default_rng(0)
    step = np.where(MESH.rim, 0.0, 1e-7 * rng.standard_normal(len(MESH.nodes)))
    there, back = cast(base + step), cast(base - step)
    common = (there.triangle == hits.triangle) & (back.triangle == hits.triangle)
    difference = 0.5 * (there.range_m - back.range_m)
    assert (D @ step)[common] == pytest.approx(difference[common], abs=2e-12)
    along_ray = np.einsum("ij,ij->i", CAMERA.directions[hits.ray], interpolated(MESH.normals))
    paper = interpolated(step) * along_ray
    wrong = np.linalg.norm((paper - difference)[common]) / np.linalg.norm(difference[common])
    assert wrong > 0.05, "Eq. 19's coefficient should not be the derivative on a dented surface"


def test_the_model_around_a_shape_is_exact_to_second_order():
    """For motion in any direction, as of rubber."""
    observer, random = RangeObserver(CAMERA, MESH, 0.01, block=2), np.random.default_rng(0)
    base, turn = MESH.deformed(smooth_dent(0.01)), random.standard_normal(3)
    motion = np.outer(smooth_dent(0.001), turn / np.linalg.norm(turn))
    view = observer.around(base)

    def error(fraction: float) -> float:
        model = view.model_m[view.block] + view.jacobian @ (fraction * motion).ravel()
        there = observer.around(base + fraction * motion).model_m[view.block]
        return float(np.sqrt(np.mean((model - there) ** 2)))

    assert error(0.25) < error(1.0) / 8


@pytest.mark.parametrize("block", [1, 2, 5])
def test_block_averages_measure_a_deformation_despite_noise_holes_and_bias(block):
    displacement = smooth_dent(0.008)
    ranges = MembraneView(CAMERA, MESH).range_image(displacement)
    rng = np.random.default_rng(1)
    shape = ranges.shape
    bias = 0.002 * rng.standard_normal(shape)
    pixels = PixelModel(rng.random(shape) < 0.9, bias, np.full(shape, 1e-4))
    noisy = ranges + bias + 1e-4 * rng.standard_normal(shape)
    depth = CAMERA.depth_image(noisy).astype(np.float32)
    depth[rng.random(shape) < 0.1] = np.nan
    observer = RangeObserver(CAMERA, MESH, 0.01, pixels, block)
    seen = observer.observe(depth)
    used = seen.weight > 0
    error = (seen.residual_m - at(observer, displacement))[used]
    # White noise averages out; what is left is the curvature of the range within a block.
    assert np.sqrt(np.mean(error**2)) < 1.5e-4 / block + 2e-5 * block**2


def test_outliers_from_a_model_have_little_weight():
    displacement = smooth_dent(0.008)
    ranges = MembraneView(CAMERA, MESH).range_image(displacement)
    rng = np.random.default_rng(2)
    noisy = ranges * (1 + 0.002 * rng.standard_normal(ranges.shape))
    wild = rng.random(ranges.shape) < 0.2
    noisy[wild] += 0.004
    observer = RangeObserver(CAMERA, MESH, 0.002, block=4)
    depth = CAMERA.depth_image(noisy).astype(np.float32)
    truth = at(observer, displacement)

    def bias(seen):
        return float(np.median((seen.residual_m - truth)[seen.weight > 0]))

    assert bias(observer.observe(depth)) > 7e-4
    assert bias(observer.observe(depth, truth)) < 2e-4


@pytest.mark.parametrize("share", [0.003, 0.03, 0.1])
def test_false_returns_are_none_without_a_model_too(share):
    displacement, rng = smooth_dent(0.008), np.random.default_rng(2)
    ranges = MembraneView(CAMERA, MESH).range_image(displacement)
    ranges *= 1 + 0.002 * rng.standard_normal(ranges.shape)
    observer = RangeObserver(CAMERA, MESH, 0.002, block=4)
    depth = CAMERA.depth_image(ranges).astype(np.float32)
    wild = np.flatnonzero(rng.random(depth.shape) < share)
    absent, false = depth.copy(), depth.copy()
    absent.flat[wild] = np.nan
    off_m = rng.uniform(0.02, 0.3, len(wild)) * rng.choice([-1.0, 1.0], len(wild))
    false.flat[wild] = np.maximum(depth.flat[wild] + off_m, 0.005)
    true, seen = observer.observe(absent), observer.observe(false)
    np.testing.assert_allclose(seen.weight, true.weight, rtol=1e-6)
    np.testing.assert_allclose(seen.residual_m, true.residual_m, atol=1e-9)


def test_false_returns_of_whole_blocks_are_none_too():
    """In patches of nine by nine pixels, three hundredths of the image in all."""
    displacement, rng = smooth_dent(0.008), np.random.default_rng(2)
    ranges = MembraneView(CAMERA, MESH).range_image(displacement)
    observer = RangeObserver(CAMERA, MESH, 0.002, block=4)
    depth = CAMERA.depth_image(ranges * (1 + 0.002 * rng.standard_normal(ranges.shape)))
    for row, column in zip(rng.integers(0, 162, 14), rng.integers(0, 215, 14), strict=True):
        depth[row : row + 9, column : column + 9] = rng.uniform(0.02, 0.05)
    seen = observer.observe(depth.astype(np.float32))
    used = seen.weight > 0
    assert np.mean(used) > 0.95
    assert np.abs((seen.residual_m - at(observer, displacement))[used]).max() < 0.002


def test_outliers_among_correlated_pixels_have_little_weight_too():
    """A fifth of the image, in squares, is off; few pixels are looked at to find that out."""
    displacement = smooth_dent(0.008)
    ranges = MembraneView(CAMERA, MESH).range_image(displacement)
    noise = np.full(ranges.shape, 1e-4)
    pixels = PixelModel(np.ones(ranges.shape, bool), 0.0 * noise, noise, correlated_pixels=144.0)
    wild = np.kron(np.random.default_rng(4).random((22, 28)) < 0.2, np.ones((8, 8)))[:171, :224]
    observer = RangeObserver(CAMERA, MESH, 0.01, pixels, block=4)
    depth = CAMERA.depth_image(ranges + 0.02 * wild).astype(np.float32)
    truth = at(observer, displacement)
    plain, robust = observer.observe(depth), observer.observe(depth, truth)
    assert robust.trusted < 0.9
    seen = plain.weight > 0
    wrong = plain.residual_m - truth > 0.01
    assert np.median((robust.weight / plain.weight)[seen & wrong]) < 0.6
    assert robust.weight[seen & ~wrong] == pytest.approx(plain.weight[seen & ~wrong], rel=0.05)


@pytest.mark.parametrize("value_m", [0.001, 0.25, 12.0])
def test_one_bad_pixel_is_found_wherever_it_is(value_m):
    """Although few of the pixels, which a filter made alike, are looked at for many outliers."""
    noise = np.full((171, 224), 1e-4)
    pixels = PixelModel(np.ones(noise.shape, bool), 0.0 * noise, noise, correlated_pixels=144.0)
    observer = RangeObserver(CAMERA, MESH, 0.01, pixels, block=4)
    ranges = MembraneView(CAMERA, MESH).range_image(np.zeros(len(MESH.nodes)))
    untouched = CAMERA.depth_image(ranges).astype(np.float32)
    for pixel in np.random.default_rng(6).choice(observer.pixel, 20):
        depth = untouched.copy()
        depth.flat[pixel] = value_m
        seen = observer.observe(depth, np.zeros(observer.blocks))
        assert (np.abs(seen.residual_m) * np.sqrt(seen.weight)).max() < 1.0
        assert np.count_nonzero(seen.weight == 0.0) == 0


def test_clean_pixels_keep_their_full_weight():
    observer = RangeObserver(CAMERA, MESH, 0.01, block=2)
    ranges = MembraneView(CAMERA, MESH).range_image(np.zeros(len(MESH.nodes)))
    rng = np.random.default_rng(3)
    noisy = ranges * (1 + 0.01 * rng.standard_normal(ranges.shape))
    depth = CAMERA.depth_image(noisy).astype(np.float32)
    with_model = observer.observe(depth, np.zeros(observer.blocks))
    assert with_model.weight == pytest.approx(observer.observe(depth).weight)


def looked_at(noise: np.ndarray, sigma: float):
    """Misfit of noisy ranges (H, W) of a dent to the model of the same dent."""
    displacement = smooth_dent(0.006)
    observer = RangeObserver(CAMERA, MESH, sigma, block=2)
    ranges = MembraneView(CAMERA, MESH).range_image(displacement)
    depth = CAMERA.depth_image(ranges * (1.0 + noise)).astype(np.float32)
    view = observer.around(MESH.deformed(displacement))
    observation = observer.observe(depth, view.model_m)
    error = (observation.residual_m - view.model_m)[view.block]
    return observer.misfit(observation, view.block, error, 1.0)


def test_expected_noise_is_one_deviation_and_white():
    rng = np.random.default_rng(5)
    found = looked_at(0.01 * rng.standard_normal((171, 224)), 0.01)
    assert found.rms_m == pytest.approx(0.01 * 0.15 / 2, rel=0.1)  # of four pixels' mean
    assert found.deviations == pytest.approx(1.0, rel=0.05)
    assert found.clumping == pytest.approx(1.0, abs=0.25)


def test_noise_factor_uses_mostly_visible_blocks():
    """Correlated noise raises the factor; a sparsely visible half does not affect it."""
    rows, columns = 60, 80
    squares, rng = BlockSquares(np.arange(rows * columns), columns), np.random.default_rng(0)
    block, white = np.arange(rows * columns), rng.standard_normal((rows, columns))
    assert squares.noise_factor(block, 3.0 * white.ravel()) == pytest.approx(3.0, rel=0.15)
    assert squares.noise_factor(block, 0.3 * white.ravel()) == pytest.approx(0.3, rel=0.15)
    steady = squares.noise_factor(block, 3.0 * white.ravel(), steady=True)
    assert steady == pytest.approx(3.0, rel=0.15)
    shared = np.repeat(np.repeat(rng.standard_normal((15, 20)), 4, axis=0), 4, axis=1)
    assert squares.noise_factor(block, shared.ravel()) > 2.0
    sparse = white.copy()
    sparse[:40] = np.where(rng.random((40, columns)) < 0.1, 50.0, 0.0)
    assert squares.noise_factor(block, sparse.ravel()) == pytest.approx(1.0, abs=0.4)
    assert squares.noise_factor(block, 0.0 * white.ravel()) == 1.0


@pytest.mark.parametrize(
    ("factor", "least", "most"), [(0.3, 0.3, 0.6), (1.5, 1.4, 1.7), (3, 2.8, 3.3)]
)
def test_the_noise_factor_is_relative_to_the_camera(factor, least, most):
    """Below 1 it is an upper bound of the errors' factor."""
    observer = RangeObserver(CAMERA, MESH, 0.01, block=2)
    ranges = MembraneView(CAMERA, MESH).range_image(np.zeros(len(MESH.nodes)))
    noise = 0.01 * np.random.default_rng(3).standard_normal(ranges.shape)
    depth = CAMERA.depth_image(ranges * (1.0 + noise)).astype(np.float32)
    observation = observer.observe(depth, np.zeros(observer.blocks))
    block = observer.around(MESH.nodes).block
    found = observer.noise_factor(observation, block, factor * observation.residual_m[block])
    assert least < found < most


def test_correlated_noise_is_detected():
    """Squares of 16 × 16 pixels with one error each: 64 blocks are worth a sample."""
    rng = np.random.default_rng(6)
    squares = np.kron(rng.standard_normal((11, 14)), np.ones((16, 16)))[:171, :224]
    found = looked_at(0.01 * squares, 0.01)
    assert found.clumping == pytest.approx(64.0, rel=0.1)
    assert found.deviations == pytest.approx(2.0, rel=0.25)  # the mean of four is no better


@pytest.mark.parametrize(
    ("model", "distortion", "off"),
    [
        ("none", (), 0.0),
        ("inverse_brown_conrady", (-0.06, 0.06, 8e-4, 1e-3, -0.02), 2e-3),
        ("plumb_bob", (-0.2, 0.06, 8e-4, 1e-3), 5e-3),
    ],
)
def test_a_field_in_the_image_is_cast_on_the_deformed_membrane(model, distortion, off):
    own = replace(CAMERA.intrinsics, distortion_model=model, distortion=distortion)
    displacement = smooth_dent(0.012)
    field = np.exp(-((MESH.nodes[:, 0] - 0.012) ** 2 + MESH.nodes[:, 1] ** 2) / 0.015**2)
    view = MembraneView(DepthCamera(own, CAMERA.T_B_C), MESH)
    hits = view.hits(displacement)
    whole = np.zeros(view.shape, bool)
    values = np.einsum("ij,ij->i", hits.barycentric, field[MESH.triangles[hits.triangle]])
    whole.ravel()[hits.ray[values > 0.4]] = True
    assert whole.sum() > 500
    seen = view.above(displacement, field, 0.4)
    assert np.count_nonzero(seen != whole) <= off * whole.sum()
    assert not view.above(displacement, field, 2.0).any()


@pytest.mark.parametrize("depth_m", [0.0, 0.003, 0.02])
def test_ranges_equal_those_of_ray_casting(depth_m):
    """By Open3D's bounding volumes, which do not use adjacency."""
    own = replace(CAMERA.intrinsics, cx=CAMERA.intrinsics.cx + 90.0)  # some miss the membrane
    view = MembraneView(DepthCamera(own, CAMERA.T_B_C), MESH)
    displacement = smooth_dent(depth_m)
    pixels = np.arange(0, own.width * own.height, 7)
    hits = view.hits(displacement, pixels)
    expected = np.full(own.width * own.height, np.nan)
    expected[hits.ray] = hits.range_m
    assert 1000 < np.isfinite(expected[pixels]).sum() < len(pixels)
    found = view.ranges(displacement, pixels)
    np.testing.assert_allclose(found, expected[pixels], rtol=0, atol=1e-7)


def test_field_beyond_the_image_is_drawn_up_to_the_border():
    """Part of the membrane is outside the image of a camera that looks aside."""
    own = replace(CAMERA.intrinsics, cx=CAMERA.intrinsics.cx + 90.0, cy=20.0)
    view = MembraneView(DepthCamera(own, CAMERA.T_B_C), MESH)
    rest = np.zeros(len(MESH.nodes))
    assert np.array_equal(view.above(rest, rest + 1.0, 0.0), np.isfinite(view.range_image(rest)))


def test_a_pixels_file_of_another_camera_is_refused(tmp_path):
    path = tmp_path / "pixels.npz"
    np.savez(path, mask=np.ones((4, 4), bool), bias_m=np.zeros((4, 4)), noise_m=np.ones((4, 4)),
             correlated_pixels=1.0)  # fmt: skip
    with pytest.raises(InputError, match="4×4 pixels"):
        PixelModel.load(path, (171, 224))
