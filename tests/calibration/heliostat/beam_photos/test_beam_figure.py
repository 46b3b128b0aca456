"""The figure of a beam: in metres, the right way up, also without a beam."""

import numpy as np

from calibration.heliostat.beam_photos.light.beam_image import measure_beam
from calibration.heliostat.beam_photos.pipeline.figures import beam_image_figure
from heliogauge.reporting.canvas import png_of
from tests.calibration.beam_pictures import gaussian, picture, sky_light


def test_axes_in_metres() -> None:
    image = picture(sky_light() + 90 * gaussian((1.0, 0.5)))
    figure = beam_image_figure(image, measure_beam(image), aim_m=np.array([0.5, 0.0]), title="AA39, 12:00")
    axes = figure.axes[0]
    assert np.allclose(axes.get_xlim(), (-4, 4))
    assert np.allclose(axes.get_ylim(), (-3.5, 3.5))
    texts = [handle.get_label() for handle in axes.get_legend_handles_labels()[0]]
    assert "centroid of the light" in texts
    assert "aim point" in texts
    centroid = next(line for line in axes.lines if line.get_label() == "centroid of the light")
    assert np.allclose(np.ravel(centroid.get_xydata()), [1.0, 0.5], atol=0.01)
    assert any("from aim point\n+0." in text.get_text() for text in figure.texts)
    assert png_of(figure).startswith(b"\x89PNG")


def test_without_a_beam() -> None:
    image = picture(sky_light(), noise_dn=1.0)
    figure = beam_image_figure(image, measure_beam(image))
    assert any("no beam" in text.get_text() for text in figure.texts)
    assert not figure.axes[0].get_legend_handles_labels()[0]
