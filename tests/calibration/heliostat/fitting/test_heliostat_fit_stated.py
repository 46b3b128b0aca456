"""Rows that lie within their stated sigma are no outliers, however well the others fit."""

from dataclasses import replace

import numpy as np

from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.presets import azimuth_elevation
from calibration.heliostat.observations.observations import Observations
from tests.calibration.heliostat_days import beams, year


def test_only_rows_beyond_their_stated_sigma_are_outliers() -> None:
    """Beams that scatter by 4 mm where 50 mm were stated; one is 80 mm off, one 1 m."""
    design = azimuth_elevation("h", [10.0, 60.0, 1.5]).with_free("5")
    seen = beams(design, design.parameters.values, year(30), 0.05, np.random.default_rng(3), noise_m=0.004)
    spot = seen.spot_m.copy()
    spot[4, 2] += 0.08
    spot[9, 2] += 1.0
    found = fit(design, Observations((replace(seen, spot_m=spot),)))
    assert found.sigma_factors["beam"] < 0.2
    assert np.flatnonzero(found.rejected).tolist() == [9]
