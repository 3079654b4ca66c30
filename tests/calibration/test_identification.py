"""Complete identification of a synthetic twin of the real press."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.calibration import Quantity, Settings, Step, Workbench, write_sensor
from bubbleviz.camera import PixelModel
from bubbleviz.errors import InputError
from bubbleviz.membrane import balance_tension, build_mesh, reference_tension, rubber_and_variants
from bubbleviz.recordings import find_contact_free
from bubbleviz.sensor import load_sensor
from tests.small_press import changed

from .identified import identify
from .twin import ATMOSPHERE, FREE, GAUGE, cast, make_twin, nominal_sensor, residuals_and_bias


@pytest.fixture(scope="module")
def twin():
    return make_twin()


@pytest.fixture(scope="module")
def found(twin):
    return identify(twin, nominal_sensor(), range(20), nodes=500)


@pytest.mark.parametrize("pressure", [True, False])
def test_contact_free_frames_are_found(pressure):
    result = find_contact_free(make_twin(seed=3, pressure=pressure))
    assert result.frames.start == 0
    assert abs(result.frames.stop - FREE) <= 3
    assert (result.pressure_score is not None) == pressure


def test_surface_predicts_held_out_frames(twin, found):
    frames = [twin[k] for k in range(20, FREE)]
    residual, bias = residuals_and_bias(found, frames)
    size = np.abs(residual)
    assert np.nanmedian(size) < 0.1e-3  # not the rms: 2 % of single returns are 10 mm off
    assert np.nanpercentile(size, 95) < 0.25e-3
    assert np.nanmedian(np.abs(residual - bias)) < 0.78 * np.nanmedian(size)  # 0.72
    assert np.abs(np.nanmedian(residual - bias, axis=1)).max() < 2e-5


def test_surface_equals_ground_truth_and_beats_the_ellipsoid(twin, found):
    """On visible and hidden parts, against the twin's dome without noise, holes or bias."""
    sideways = found.model.camera.T_B_C[:2, 3] - twin.camera.T_B_C[:2, 3]
    assert np.abs(sideways).max() < 5e-4
    modelled = found.modelled_range_m[found.pixels.mask]
    truth = cast(twin.truth, twin.camera, np.zeros(len(twin.truth.nodes)))[found.pixels.mask]
    error = modelled - truth
    rms = np.sqrt(np.nanmean(error**2))
    assert rms < 0.1e-3
    assert rms < 0.5 * found.surfaces.left_out_rms_m["ellipsoid"]


def test_surface_hardly_depends_on_the_place_in_the_image():
    """Tiles of the cross-validation lie elsewhere; another half decade of λ would be 1.4 %."""
    twin, tensions = make_twin(seed=6, frames=20), []
    lens = twin.intrinsics
    for rows, columns in ((3, 5), (7, 7)):
        moved = replace(
            twin,
            depth=np.pad(twin.depth, ((0, 0), (rows, 0), (columns, 0)), constant_values=np.nan),
            intrinsics=replace(
                lens,
                width=lens.width + columns,
                height=lens.height + rows,
                cx=lens.cx + columns,
                cy=lens.cy + rows,
            ),
        )
        settings = Settings(Step.SURFACE, ((0, 20),), nodes=300, surface="free-form", search=False)
        surfaces = Workbench(moved, nominal_sensor()).work(settings).surfaces
        tensions.append(balance_tension(surfaces.mesh, GAUGE))
    assert tensions[0] == pytest.approx(tensions[1], rel=0.007)


def test_faulty_pixels_are_excluded(twin, found):
    assert not (found.pixels.mask & twin.false_returns).any()
    assert (found.pixels.mask & twin.rim_biased).sum() < 0.1 * twin.rim_biased.sum()
    assert found.pixels.mask.sum() > 0.5 * np.isfinite(twin.depth[0]).sum()
    assert sum(found.pixels.removed.values()) + found.pixels.mask.sum() == found.pixels.mask.size


def test_mesh_keeps_its_rim_plane_and_shape(found):
    np.testing.assert_allclose(found.mesh.nodes[found.mesh.rim, 2], 0.0, atol=1e-12)
    assert np.degrees(found.mesh.angles.min()) > 25.0
    unseen = found.mesh.nodes[found.mesh.nodes[:, 0] < -0.05]
    assert np.abs(found.surfaces.cap.distance(unseen)).max() < 1e-3


def test_tension_and_noise(twin, found):
    truth = balance_tension(twin.truth, GAUGE)  # bent most at the rim, which is hidden
    assert found.tension_n_per_m == pytest.approx(truth, rel=0.03)
    by_shape = found.tension_by_shape
    assert by_shape.low < truth < by_shape.high and by_shape.half_width < 0.05 * truth
    assert found.surfaces.chosen == "free-form"
    assert found.sensor.pneumatics.gauge_pressure_pa == pytest.approx(GAUGE, abs=5.0)
    noise = found.samples.statistics.noise_m[found.pixels.mask]
    assert noise.mean() == pytest.approx(6e-5, rel=0.4)


def test_tension_interval_includes_the_gauge_pressure_uncertainty(twin, tmp_path):
    """A wrong atmospheric pressure in the sensor file shifts γ0 within its interval."""
    truth, sensor = balance_tension(twin.truth, GAUGE), nominal_sensor()
    air = {"atmospheric_pressure_pa": ATMOSPHERE - 1500.0}
    sensor = changed(sensor, pneumatics=air)
    found = identify(twin, sensor, range(20), nodes=300)
    by_shape, tension = found.tension_by_shape, found.tension
    assert by_shape.low > 1.2 * truth and tension.low < truth < tension.high
    write_sensor(found, tmp_path / "mine.toml")
    sensor = load_sensor(tmp_path / "mine.toml")
    low, high = sensor.calibration.gauge_interval_pa
    assert low < GAUGE < high and high - low == pytest.approx(4e3, rel=0.01)
    whole = np.ptp(sensor.calibration.tension_interval_n_per_m)
    by_gauge = (high - low) / sensor.pneumatics.gauge_pressure_pa * tension.value
    # ends that lie apart unevenly add to at most twice the squared mean
    assert 0.99 < (whole**2 - by_gauge**2) / (2.0 * by_shape.half_width) ** 2 < 2.01


def test_bounds_in_the_file_are_possible_and_keep_the_deviation(found, tmp_path):
    """γ0 and the gauge pressure are positive, however wide their distributions."""
    wide = replace(found, gauge=Quantity.normal(5000.0, 4000.0))
    write_sensor(wide, tmp_path / "wide.toml")
    sensor = load_sensor(tmp_path / "wide.toml")
    known = sensor.calibration
    assert known.gauge_interval_pa[0] == known.tension_interval_n_per_m[0] == 0.0
    sensor, mesh = changed(sensor, pneumatics={"gauge_sigma_pa": None}), build_mesh(sensor)
    _, varied = rubber_and_variants(sensor, mesh, reference_tension(sensor, mesh))
    assert varied[-1].gauge_pressure_pa == pytest.approx(9000.0, abs=1.0)
    assert all(each.mean_tension < 2.0 * wide.tension.value for each in varied)


def test_written_sensor_reads_back(found, tmp_path):
    write_sensor(found, tmp_path / "mine.toml")
    sensor = load_sensor(tmp_path / "mine.toml")
    mesh = build_mesh(sensor)
    np.testing.assert_allclose(mesh.nodes[mesh.rim, 2], 0.0, atol=1e-9)
    assert mesh.cap_volume() == pytest.approx(found.mesh.cap_volume(), rel=1e-9)
    pixels = PixelModel.load(sensor.resolve(sensor.calibration.pixels_file))
    np.testing.assert_array_equal(pixels.mask, found.pixels.mask)


def test_frames_beyond_the_recording_are_refused(twin):
    with pytest.raises(InputError, match="not within its"):
        identify(twin, nominal_sensor(), range(90, 99))
