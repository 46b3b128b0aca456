"""A given pose against the outline in the image."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene
from data_synth.optics.surface_errors import SurfaceErrors
from deflectometry.keys import load_deflectometry
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.measure import run
from deflectometry.shape.smooth_shape import Align
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
