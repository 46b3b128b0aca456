"""Synthetic heliostats from their files to fitted models, against the truth beside them."""

import numpy as np
import pytest

from calibration.heliostat.files.sources import open_source
from calibration.heliostat.fitting import FitOptions, fit
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.kinematic_model import PlaneTarget
from calibration.heliostat.observations.observed import observed
from calibration.heliostat.observations.rows import parse_rows
from calibration.heliostat.pipeline.nominal_design import nominal_design
from calibration.heliostat.pipeline.photo_beams import with_measured_beams
from calibration.heliostat.planning import beam_angles, commanded_offsets
from data_synth.heliostats.dataset import iterate_photos, read_heliostat_truth, write_heliostat_dataset
from data_synth.heliostats.presets import HeliostatChoice, heliostat_scene
from heliogauge.geometry.sun import Site, sun_directions


def measured(folder, scene, options=None, terms=""):
    """Write a scene, read it, fit each heliostat; yield name, rows, fit and truth."""
    write_heliostat_dataset(folder, scene)
    file = folder / "measurement.toml"
    file.write_text(file.read_text().replace('free = "8"', f'free = "8"\n{terms}') + _PLAY * bool(terms))
    measurement, truth = load_heliostat(folder), read_heliostat_truth(folder)
    source = open_source(measurement)
    for task in source.tasks(source.names):
        design = nominal_design(task, source.plant, measurement.model.kinematics)
        rows = parse_rows(task.header, dict(task.records))
        rows, _ = with_measured_beams(rows, folder, source.plant, measurement.model)
        seen = observed(rows, design, source.plant, (), 1e-3 * measurement.model.evaluation.spot_sigma_mm)
        yield task.name, seen, fit(design, seen.observations, options), truth


_PLAY = """
[kinematics.parameters.backlash_1]
sigma = 0.01
[kinematics.parameters.backlash_2]
sigma = 0.01
"""


def chi_square(found, values):
    """Squared length of the errors in terms of the stated covariance, and their number."""
    free = [name for name in found.solution.names if name in values]
    index = found.design.parameters.indices(free)
    sigma = found.sigma[index]
    error = (found.values[index] - np.array([values[name] for name in free])) / sigma
    correlation = found.covariance[np.ix_(index, index)] / np.outer(sigma, sigma)
    return float(error @ np.linalg.solve(correlation, error)), len(free)


@pytest.mark.parametrize(
    ("preset", "heliostats", "options"),
    [
        ("field", 16, FitOptions(sigma="stated")),
        # Wind is not in the stated sigmas: they are estimated.
        ("juelich", 10, FitOptions(sigma="estimated")),
    ],
)
def test_errors_are_of_the_stated_size(tmp_path, preset, heliostats, options):
    """Files to fits; errors are drawn with the stated priors. 128 numbers make the ratio known to 6 %."""
    scene = heliostat_scene(preset, HeliostatChoice(2, heliostats, 50))
    if preset == "field":
        scene = scene.with_disturbances(wind_rad=0.0)
    totals = [
        chi_square(found, truth.values(name)) for name, _, found, truth in measured(tmp_path / "set", scene, options)
    ]
    chi, count = np.sum(totals, axis=0)
    assert count >= 128
    assert np.sqrt(chi / count) == pytest.approx(1, abs=0.2)


def test_a_drone_finds_the_heliostat(tmp_path):
    scene = heliostat_scene("drone", HeliostatChoice(3))
    ((_, _, found, truth),) = measured(tmp_path / "set", scene)
    chi, count = chi_square(found, truth.values("1"))
    assert count == 9
    assert chi < 25
    assert found.converged


def test_outliers_are_named_and_healthy_rows_are_not(tmp_path):
    scene = heliostat_scene("small", HeliostatChoice(5, 3, 60))
    scene = scene.with_disturbances(outliers=0.08, outlier_m=1.0, wind_rad=0.0)
    hits = np.zeros(4)
    for number, (_, _, found, truth) in enumerate(measured(tmp_path / "set", scene)):
        spoiled = truth.outlier[truth.heliostat == number][found.observations.row]
        hits += [(found.rejected & spoiled).sum(), spoiled.sum(), (found.rejected & ~spoiled).sum(), (~spoiled).sum()]
    named, spoiled_rows, accused, healthy = hits
    # An error of 1 m (1 sigma) is below three of 20 mm once in 500.
    assert named >= 0.9 * spoiled_rows > 5
    assert accused <= 0.02 * healthy


def test_play_is_found_from_the_side_of_approach(tmp_path):
    """4 mrad in both drives; a drive is approached from both sides when the campaign passes noon and the seasons."""
    scene = heliostat_scene("small", HeliostatChoice(6, 1, 80)).with_disturbances(wind_rad=0.0)
    scene = scene.with_faults(("backlash",))
    ((_, _, found, _),) = measured(tmp_path / "set", scene, terms='terms = ["backlash"]')
    for name in ("backlash_1", "backlash_2"):
        index = found.design.parameters.index(name)
        assert found.sigma[index] < 5e-4
        assert abs(found.values[index] - 4e-3) < 4 * found.sigma[index]


@pytest.mark.slow
def test_photos_become_spots_and_a_model_that_tracks(tmp_path):
    """Photos to centroids within 3 mm at 90 m, and from 16 of them a model that tracks the year within 0.15 mrad.

    The lens distorts by 2.4 px, 40 mm, at the target's corners.
    """
    scene = heliostat_scene("images-lens", HeliostatChoice(0, 1))
    ((name, seen, found, truth),) = measured(tmp_path / "set", scene)
    spots = seen.rows.vector("x_m", "y_m")
    true = np.array([photo["centroid_m"] for photo in iterate_photos(truth)])
    used = np.array([not flag for flag in seen.rows.flags])
    assert used.mean() > 0.8
    assert np.sqrt(np.mean((spots - true)[used] ** 2)) < 3e-3
    values = truth.values(name)
    real = found.design.with_value(
        {key: value for key, value in values.items() if key in found.design.parameters.names}
    )
    site = Site(**truth.parameters["site"])
    times = np.concatenate(
        [
            np.datetime64(f"2025-{month:02d}-21T09:00:00.000") + (3600_000 * np.arange(7)).astype("timedelta64[ms]")
            for month in range(1, 13)
        ]
    )
    one = truth.parameters["targets"][0]
    target = PlaneTarget.facing("upper", one["center_m"], np.radians(one["facing_azimuth_deg"]), 7.0, 7.0)
    offsets = commanded_offsets(real, found.design, sun_directions(times, site), target)
    distance = float(np.linalg.norm(target.center_m - real.position_m))
    error_mrad = 1e3 * beam_angles(offsets, distance)
    assert np.sqrt(np.mean(error_mrad**2)) < 0.15
    before = 1e3 * beam_angles(commanded_offsets(real, found.nominal, sun_directions(times, site), target), distance)
    assert np.sqrt(np.mean(before**2)) > 3
