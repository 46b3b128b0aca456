"""The numbers of the headline: all are angles of the normal."""

import re

import numpy as np
import pytest

from data_synth.troughs.presets import ls2_panelled
from heliogauge.results.folder import Summary
from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer.pipeline.headline import headline_text, slope_numbers
from observer.product.slope_map import angle_maps
from observer.trough.absorber_path import AbsorberPath
from observer.trough.visibility import Visibility


def test_mirror_alone_and_with_the_absorber_are_compared_as_angles():
    """All normals turned by 2 mrad, the tube in the focal line: SDx, theta_r and theta_ra are all 2 mrad.

    Side by side, 2.6 mrad of dz/dx and 2.0 mrad of theta_ra looked as if the absorber made up for the mirror.
    """
    collector = ls2_panelled()
    x_axis, y_axis = np.linspace(-2.4, 2.4, 50), np.linspace(-3.9, 3.9, 40)
    x, _ = np.meshgrid(x_axis, y_axis)
    design, zero, all_nodes = x / (2 * collector.focal_length_m), np.zeros(x.shape), np.ones(x.shape, dtype=bool)
    sigma = 1e-4 * (1 + design**2)
    slope_map = SlopeMap(
        x_axis,
        y_axis,
        np.tan(np.arctan(design) - 2e-3),
        zero,
        design,
        zero,
        sigma,
        sigma,
        1.0,
        no_common_modes(),
        np.full(x.shape, np.nan),
        zero.astype(np.uint32),
        all_nodes,
        design="d",
        frame="f",
        removed="nothing",
    )
    angles = angle_maps(slope_map, AbsorberPath.straight(0.0, collector.focal_length_m, 4.0), collector)
    numbers = slope_numbers(slope_map, angles, Visibility(zero.astype(np.uint32), all_nodes, -3.0, 3.0))
    assert numbers["rms_theta_r_rad"] == numbers["sdx_rad"] == pytest.approx(2e-3, rel=1e-9)
    assert numbers["mean_theta_r_rad"] == pytest.approx(2e-3, rel=1e-9)
    assert numbers["rms_theta_ra_rad"] == pytest.approx(2e-3, rel=1e-9)
    # Without the mean of dz/dx, 2 mrad x^2 / 4 f^2 about its mean are left of this turn, as on any steep mirror.
    left = np.arctan(slope_map.slope_x - np.mean(slope_map.slope_x - design)) - np.arctan(design)
    assert numbers["sdx_tilt_removed_rad"] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-9)
    assert numbers["median_sigma_theta_r_rad"] == pytest.approx(1e-4, rel=3e-3)
    others = dict.fromkeys(
        (
            "photos_count",
            "edges_used_count",
            "absorber_mean_x_m",
            "absorber_mean_z_offset_m",
            "intercept_ratio",
            "intercept_gain_absorber_aligned_ratio",
            "intercept_gain_mirror_perfect_ratio",
            "intercept_gain_panels_turned_ratio",
            "sigma_intercept_gain_panels_turned_ratio",
        ),
        0.5,
    ) | {"panels_count": 8, "panels_to_turn_count": 3, "panels_worth_turning_count": 2}
    texts = {"design": "d", "encoding": "e", "light": "l"}
    said = headline_text(Summary("observer", "t", numbers | others, texts=texts))
    assert re.search(r"SDx +2\.0\d* ± [\d.]+ mrad \(RMS of theta_r\)", said)
    assert re.search(r"with the absorber theta_ra 2\.0\d* ± [\d.]+ mrad RMS", said)
    assert "turning 3 of 8 gains 50 ± 50 % of the light, 2 of them worth a turn;" in said
    # Independent nodes, and a tube whose place is held.
    assert numbers["sigma_rms_theta_r_rad"] == pytest.approx(1e-4 / np.sqrt(2000), rel=3e-3)
    assert numbers["median_sigma_theta_ra_rad"] == pytest.approx(numbers["median_sigma_theta_r_rad"], rel=1e-6)
    # What a wrong focal length makes of the tube's best place is no gain of -1 %, and a mean height hides a sag.
    assert "an aligned absorber gains 50 % of the light, perfect mirrors gain 50 % of the light" in said
    assert "than at them" not in said
    own = {"absorber_sag_down_m": 7.1e-3, "sigma_absorber_sag_down_m": 3e-4, "absorber_spans_measured_count": 1}
    own |= {"intercept_gain_absorber_aligned_ratio": -0.0101, "sigma_intercept_gain_absorber_aligned_ratio": 1e-3}
    said = headline_text(Summary("observer", "t", numbers | others | own, texts=texts))
    assert "an absorber on the stated focal line loses 1.01 ± 0.10 % of the light" in said
    assert "on average; between supports up to 7.10 ± 0.30 mm lower than at them" in said
    for sag in (8e-4, -8e-4, -1e-3):
        of_sag = numbers | others | own | {"absorber_sag_down_m": sag}
        said = headline_text(Summary("observer", "t", of_sag, texts=texts))
        assert ("higher than at them" in said) == (sag < -9e-4), sag
    # The largest of eight spans is 3.3 sigma off by chance; without its sigma nothing is sure.
    for other in ({"absorber_spans_measured_count": 8}, {"sigma_absorber_sag_down_m": None}):
        of_sag = numbers | others | own | {"absorber_sag_down_m": -1e-3} | other
        assert "than at them" not in headline_text(Summary("observer", "t", of_sag, texts=texts)), other
