"""A given pose against the outline in the image."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene
from data_synth.optics.surface_errors import SurfaceErrors
from deflectometry.keys import load_deflectometry
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.measure import run
from deflectometry.pose.given_pose import check_given_pose
from deflectometry.pose.outline_edges import OutlineSearch
from deflectometry.pose.pose_observations import KnownPoints, UncertainPose
from deflectometry.shape.smooth_shape import Align
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, plane
from heliogauge.validate import Float32Array
from tests.recovery.agreement import agreement, measure


@pytest.mark.slow
@pytest.mark.parametrize("blur_px", [0.1, 0.4])
def test_blurred_edges_are_masked_though_the_pose_is_known(tmp_path, blur_px):
    """With blur a pixel near the edge lacks light from one side and sees the screen off: 11 sigma at 0.7 px."""
    scene = preset_scene("small")
    scene = replace(
        scene, blur_sigma_px=blur_px, facets=tuple(replace(one, errors=SurfaceErrors()) for one in scene.facets)
    )
    result = measure(scene, tmp_path / "m", knowledge=Knowledge(pose_known=True), options=Options(align=Align.OUTLINE))
    found = agreement(result, tmp_path / "m")
    border = np.maximum(np.abs(found.x_m), np.abs(found.y_m)) > 0.565
    pulls = (found.difference_rad / found.sigma_random_rad)[:, border]
    assert np.count_nonzero(border) > 200
    assert np.sqrt((pulls**2).mean()) < 1.2


@pytest.mark.slow
def test_pose_that_the_image_contradicts_is_said(tmp_path):
    knowledge = Knowledge(pose_known=True)
    scene = preset_scene("small")
    exact = measure(scene, tmp_path / "m", knowledge=knowledge)
    assert not any(one.code == "given_pose_off_outline" for one in exact.doubts)
    path = tmp_path / "m" / "measurement.toml"
    text = path.read_text()
    line = next(one for one in text[text.index("[mirror.pose]") :].splitlines() if one.startswith("translation_m"))
    moved = [float(part) for part in line.split("[")[1].strip("] ").split(",")]
    moved[0] += 0.02
    path.write_text(text.replace(line, f"translation_m = {moved}"))
    result = run(load_deflectometry(tmp_path / "m"))
    # 20 mm are 1.4 px, across two of the four sides: 1 px RMS over all.
    doubt = next(one for one in result.doubts if one.code == "given_pose_off_outline")
    assert doubt.numbers["residual_rms_px"] == pytest.approx(1.0, abs=0.1)


CAMERA = Camera(300, 240, 900.0, 900.0, 149.5, 119.5)
FACET = Facet("facet", np.array([[-0.4, -0.3], [0.4, -0.3], [0.4, 0.3], [-0.4, 0.3]]), plane())
STRAIGHT = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 5.0]))


def bright_rectangle() -> Float32Array:
    """Return what the camera sees of the facet: a step of 100 DN, 0.7 px blurred, and noise of 1 DN."""
    x, y = np.meshgrid(np.arange(300.0), np.arange(240.0))
    bright = [ndtr((900 * half / 5 - np.abs(one)) / 0.7) for one, half in ((x - 149.5, 0.4), (y - 119.5, 0.3))]
    return (100 * bright[0] * bright[1] + np.random.default_rng(3).normal(0, 1.0, x.shape)).astype(np.float32)


def test_edges_that_dots_touch_everywhere_are_said_to_be_so():
    given = UncertainPose(STRAIGHT, 1e-12 * np.eye(6))
    checked = check_given_pose(bright_rectangle(), CAMERA, [FACET], given, np.ones((240, 300), dtype=np.bool_))
    assert checked.doubt is not None
    assert "dots that stand close to each other touch" in checked.doubt.text
    assert "focal length" not in checked.doubt.text


def test_edges_scatter_about_their_own_outline_wherever_the_given_pose_puts_it():
    """Cut dots take this scatter for the outline's uncertainty: it is the edges' own, not that of the given pose."""
    image = bright_rectangle()
    found = []
    for aside_m in (0.0, 0.3 * 5 / 900):
        moved = RigidTransform(STRAIGHT.rotation, STRAIGHT.translation_m + [aside_m, 0.0, 0.0])
        found.append(check_given_pose(image, CAMERA, [FACET], UncertainPose(moved, 1e-12 * np.eye(6))))
    # Noise of 1 DN on a step of 100 DN that is 0.7 px blurred places an edge to some hundredths of a pixel.
    assert 0.003 < found[0].scatter_px < 0.05
    assert found[0].residual_rms_px == pytest.approx(found[0].scatter_px, rel=0.2)
    assert found[1].scatter_px == pytest.approx(found[0].scatter_px, rel=0.05)
    assert found[1].residual_rms_px > 4 * found[1].scatter_px


def test_a_pose_that_has_gone_astray_is_refused_and_no_bug():
    search = OutlineSearch(bright_rectangle(), CAMERA, [FACET], 1.0, 120.0)
    astray = RigidTransform(STRAIGHT.rotation, np.array([1e22, 0.0, 5.0]))
    with pytest.raises(EstimationError, match="edge points"):
        search.follow(astray, KnownPoints())
