"""Render quality by renderer, checked in the pixels of the view."""

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import rgb
from bubbleviz_ui.view3d.render_view import FAST, SMOOTH, VARIABLE, detect_quality, quality_for
from bubbleviz_ui.view3d.tools import DOT
from bubbleviz_ui.window_session import application

SOFTWARE = (
    "llvmpipe (LLVM 15.0.6, 256 bits)",
    "softpipe",
    "Software Rasterizer",
    "SWR (LLVM 11.0.0, 256 bits)",
    "Mesa OffScreen",
    "Mesa DRI swrast",
    "Apple Software Renderer",
    "Microsoft Basic Render Driver",
    "GDI Generic",
    "",
)
GPUS = (
    "NVIDIA GeForce RTX 4060 Laptop GPU/PCIe/SSE2",
    "Mesa Intel(R) UHD Graphics 620 (KBL GT2)",
    "AMD Radeon RX 580 Series (polaris10, LLVM 15.0.7, DRM 3.54)",
    "Apple M2",
    "V3D 4.2",
    "virgl (SWRITE GPU)",
)


@pytest.mark.parametrize("renderer", [*SOFTWARE, *GPUS])
def test_software_renderer_is_fast_gpu_smooth_unless_overridden(renderer):
    usual, other = (FAST, SMOOTH) if renderer in SOFTWARE else (SMOOTH, FAST)
    found, wanted = quality_for(renderer), quality_for(renderer, other.name)
    for quality, kind in ((found, usual), (wanted, other)):
        assert (quality.name, quality.samples) == (kind.name, kind.samples)
    assert found.own_swap != found.round_points == (found.samples > 1) == (usual is SMOOTH)
    assert renderer in found.text and renderer in wanted.text


def test_quality_from_the_driver_or_the_environment_variable(monkeypatch):
    application()
    monkeypatch.delenv(VARIABLE, raising=False)
    found = detect_quality()
    assert found.renderer and found == quality_for(found.renderer)
    for wanted in (FAST, SMOOTH):
        monkeypatch.setenv(VARIABLE, wanted.name)
        assert detect_quality().name == wanted.name
    monkeypatch.setenv(VARIABLE, "best")
    with pytest.raises(InputError, match=f"{VARIABLE} is 'best'; set it to fast or smooth"):
        detect_quality()


@pytest.mark.parametrize("quality", [FAST, SMOOTH], ids=lambda quality: quality.name)
def test_edges_and_points_are_smooth_or_fast_and_lit_as_by_vtk(drive, quality):
    driver = drive(quality=quality)
    window, smooth = driver.window, quality is SMOOTH
    driver.choose(layers=frozenset({"rim"}))
    rim = driver.pixels()
    shades = share_of_shades(rim, theme.of(window).rim, theme.of(window).view)
    assert shades > 0.2 if smooth else shades == 0.0

    window.scene.callout.show_distance([np.array(window.view.camera.focal_point)])
    window.view.refresh()
    driver.wait_until_shown()
    dot = (driver.pixels().astype(int) - rim).any(axis=2)
    rows, columns = np.flatnonzero(dot.any(axis=1)), np.flatnonzero(dot.any(axis=0))
    inside = dot[np.ix_(rows, columns)]
    assert min(inside.shape) >= DOT - 1 and max(inside.shape) <= DOT
    corners = inside[np.ix_([0, -1], [0, -1])]
    assert corners.all() if not smooth else not corners.any()
    assert inside.mean() == pytest.approx(np.pi / 4 if smooth else 1.0, abs=0.1)
    colours = driver.pixels()[dot]
    assert (len(np.unique(colours, axis=0)) > 5) is smooth  # spheres are shaded
    # playing shows fewer points with software rendering
    driver.choose(layers=frozenset({"cloud"}), cloud_colour="plain", cloud_points=200)
    driver.wait(lambda: driver.result.cloud_m is not None)
    still = len(driver.result.cloud_m)
    assert still > 100
    driver.state.set_playing(True)
    driver.wait(lambda: driver.state.shown_frame > 3)
    moving = len(driver.result.cloud_m)
    assert (moving <= 50) == (quality is FAST)  # frames have different holes
    driver.state.set_playing(False)
    driver.wait(lambda: len(driver.result.cloud_m) > 100)
    # the membrane's lighting is that of VTK; without the dot, whose edge differs by a few pixels in
    # some renders of the same scene by the software renderer
    window.scene.callout.hide()
    driver.choose(layers=frozenset({"membrane"}))
    ours = driver.pixels().astype(int)
    assert np.ptp(ours[ours.shape[0] // 2], axis=0).max() > 30  # shaded
    actor = driver.window.scene.layers["membrane"].actor
    actor.GetShaderProperty().ClearAllFragmentShaderReplacements()
    driver.window.view.refresh()
    driver.wait_until_shown()
    assert np.abs(driver.pixels().astype(int) - ours).max() <= 1


def share_of_shades(picture, line, ground):
    """Share of antialiased pixels among those not of the background."""
    on, off = ((picture == rgb(colour)).all(axis=2) for colour in (line, ground))
    return float((~on & ~off).sum() / (~off).sum())
