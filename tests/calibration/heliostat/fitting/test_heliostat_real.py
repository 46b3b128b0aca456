"""Seven real heliostats: as good as a plain fit where that is good, better where it extrapolates, and said before."""

import numpy as np
import pytest

from calibration.heliostat.fitting.field_fit import field_names, fit_with_field, linear_rows
from calibration.heliostat.fitting.field_model import FieldUnit, learn_field
from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.model_choice import with_priors
from calibration.heliostat.fitting.priors import PRIORS
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.fitting.splits import held_out, make_split
from calibration.heliostat.observations.residuals import evaluate
from calibration.heliostat.pipeline.free_parameters import starting_design
from tests.calibration.juelich import FAULTY, FOLDER, SOUND, heliostat

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"no real heliostats beside the project ({FOLDER})")


@pytest.fixture(scope="module")
def units():
    return {name: heliostat(name) for name in SOUND}


def beam_rms_mrad(found, observations):
    return 1e3 * np.sqrt(np.mean(evaluate(found.design, found.values, observations).beam_angle_rad ** 2))


@pytest.mark.slow
@pytest.mark.parametrize(("free", "published"), [("4", (1.4, 2.3, 1.4, 2.6)), ("15", (0.9, 1.6, 1.2, 2.5))])
def test_chronological_split_is_as_good_as_a_plain_fit(units, free, published):
    ratios, errors = [], []
    for design, seen in units.values():
        held = held_out(design.with_free(free), seen, make_split(seen, "chronological"))
        parts = [seen.select(mask) for mask in (held.split.train, held.split.test)]
        plain = fit(design.with_free(free), parts[0], FitOptions(loss="squares", sigma="estimated"))
        errors.append([1e3 * held.train.beam_rms_rad, 1e3 * held.test.beam_rms_rad])
        ratios.append([own / beam_rms_mrad(plain, part) for own, part in zip(errors[-1], parts, strict=True)])
    assert (np.median(ratios, axis=0) < 1.05).all()
    assert np.max(ratios) < 1.15
    low, high = np.min(errors, axis=0), np.max(errors, axis=0)
    assert (np.array([low[0], high[0], low[1], high[1]]) < np.array(published) + 0.1).all()


@pytest.mark.parametrize("name", ["azimuth", "azimuth-reversed"])
def test_azimuth_split_with_priors_is_below_five_milliradians_and_warned(units, name):
    errors, free, ratios = [], [], []
    for design, seen in units.values():
        split = make_split(seen, name)
        held = held_out(with_priors(design), seen, split)
        assert held.doubts[0].code == "test_positions_beyond_training"
        assert held.prediction.extrapolated.all()
        errors.append(1e3 * held.test.beam_rms_rad)
        free.append(beam_rms_mrad(fit(design.with_free("4"), seen.select(split.train)), seen.select(split.test)))
        ratios.append(held.test.beam_rms_rad / np.sqrt(np.mean(held.prediction.sigma_beam_rad**2)))
    assert 0.7 < np.median(ratios) < 1.3
    assert max(ratios) < 2.5
    assert np.median(errors) < 5.0
    assert np.median(errors) < 0.75 * np.median(free)


@pytest.mark.slow
def test_each_is_predicted_across_the_sky_from_the_others(units):
    looks = {}
    for name, (design, seen) in units.items():
        start = starting_design(design)
        looks[name] = FieldUnit(name, linear_rows(fit(start, seen), field_names(start)), {})
    scales = {name: PRIORS[name].of(start.parameters.value(name)) for name in field_names(start)}
    errors = {"azimuth": [], "azimuth-reversed": []}
    for name, (design, seen) in units.items():
        field = learn_field([look for other, look in looks.items() if other != name], scales)
        model = field.model(looks[name].rows.names, {})
        assert model is not None
        for split, found in errors.items():
            parts = make_split(seen, split)
            robust = fit(starting_design(design), seen.select(parts.train))
            informed = fit_with_field(robust, model.prior(name))
            found.append(beam_rms_mrad(informed, seen.select(parts.test)))
    # What one morning cannot separate five others know: 4.6 and 4.0 mrad with general priors and independent rows.
    assert np.median(errors["azimuth"]) < 2.5
    assert np.median(errors["azimuth-reversed"]) < 2.8


def test_wrong_actuator_data_are_said_not_fitted():
    design, seen = heliostat(FAULTY)
    found = fit(with_priors(design), seen)
    assert "observations_far_from_fit" in [one.code for one in found.doubts]
