"""The beam bench on drawn photos with known truth: places, sizes, flux, canting from flux, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from calibration.beam.files.comparison import Comparison
from calibration.beam.files.result import Result
from calibration.beam.keys import load_beams
from calibration.beam.light.beam_flags import BeamFlag
from calibration.beam.light.beam_image import measure_beam
from calibration.beam.light.flux_scale import Gauge, absolute_by_gauge, absolute_by_power
from calibration.beam.mirror.flux_fit import FluxFit
from calibration.beam.pipeline import compare
from calibration.beam.pipeline.measure import run
from data_synth.heliostats import BenchOptions, write_beam_dataset
from heliogauge.errors import InputError
from heliogauge.results.arrays import read_arrays
from tests.calibration.beam_pictures import gaussian, picture, sky_light


def measured(folder: Path, *faults: str, suns: int = 1, seed: int = 0) -> Result:
    write_beam_dataset(folder, BenchOptions(suns=suns, faults=faults, seed=seed))
    return run(load_beams(folder))


def test_sizes_do_not_depend_on_the_exposure() -> None:
    """A Gaussian beam of widths s has D90 by its two widths, whatever part of it stands out of the background."""
    widths = (0.5, 0.5)
    for peak_dn in (30.0, 150.0):
        offs = []
        for seed in range(3):
            beam = measure_beam(picture(peak_dn * gaussian((0.3, -0.2), widths) + sky_light(), noise_dn=1.5, seed=seed))
            wanted = 2 * 0.5 * np.sqrt(-2 * np.log(1 - np.array([0.5, 0.9, 0.95])))
            offs.append((beam.size.diameters_m - wanted) / wanted)
            assert (np.abs(beam.size.diameters_m - wanted) < 4 * beam.size.sigma_diameters_m).all()
        # Inside the outline alone D90 would be 15 % too small at 30 DN.
        assert np.abs(np.mean(offs, axis=0)).max() < 0.015


def test_flux_by_power_and_by_gauge_agree() -> None:
    beam = measure_beam(picture(150 * gaussian((0.0, 0.0)) + sky_light(), noise_dn=1.0))
    assert beam.light is not None
    by_power = absolute_by_power(beam.size, 5000.0, 50.0)
    true_peak = 5000.0 / (2 * np.pi * 0.9 * 0.5)
    assert by_power.of_beam[0] == pytest.approx(true_peak, abs=4 * by_power.of_beam[1] + 0.01 * true_peak)
    # What a gauge of 0.3 m reads off the middle, from the closed form of the same Gaussian.
    gauge = Gauge(float(true_peak * np.exp(-0.5 * _form(0.3, 0.1))), 0.0, np.array([0.3, 0.1]), 0.1)
    by_gauge = absolute_by_gauge(beam.size, beam.light, gauge)
    assert by_gauge.of_beam[2] == pytest.approx(5000.0, abs=4 * by_gauge.of_beam[3])
    aside = Gauge(1000.0, 0.0, np.array([20.0, 0.0]), 0.1)
    with pytest.raises(InputError, match="calorimeter"):
        absolute_by_gauge(beam.size, beam.light, aside)


def _form(x: float, y: float) -> float:
    along, across = np.cos(0.6) * x + np.sin(0.6) * y, -np.sin(0.6) * x + np.cos(0.6) * y
    return float((along / 0.9) ** 2 + (across / 0.5) ** 2)


@pytest.mark.slow
def test_beams_of_a_folder_against_the_truth(tmp_path: Path) -> None:
    result = measured(tmp_path / "bench")
    truth = json.loads((tmp_path / "bench" / "truth.json").read_text())["photos"][0]
    off = [result.beams.x_m[0] - truth["centroid_m"][0], result.beams.y_m[0] - truth["centroid_m"][1]]
    assert (np.abs(off) < 4 * result.beams.sigma_m[0]).all()
    size = result.beams.sizes[0]
    for place, key in ((0, "d50_m"), (1, "d90_m")):
        assert abs(size.diameters_m[place] - truth[key]) < 4 * size.sigma_diameters_m[place]
    out = tmp_path / "out"
    out.mkdir()
    result.write(out)
    arrays, _ = read_arrays(out / "flux.nc", ("flux", "sigma_flux", "sigma_scale"))
    assert arrays["flux"].shape == (1, arrays["y"].size, arrays["x"].size)
    assert (np.diff(arrays["y"]) > 0).all()
    row, column = np.unravel_index(np.argmax(arrays["flux"][0]), arrays["flux"][0].shape)
    assert abs(arrays["x"][column] - truth["centroid_m"][0]) < 0.3
    assert abs(arrays["y"][row] - truth["centroid_m"][1]) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "flag"),
    [
        ("night", BeamFlag.NO_BEAM),
        ("cut", BeamFlag.CUT_BY_EDGE),
        ("second-beam", BeamFlag.TWO_BEAMS),
        ("overexposed", BeamFlag.SATURATED),
        ("blooming", BeamFlag.SATURATED),
    ],
)
def test_what_is_wrong_with_a_photo_is_said(tmp_path: Path, fault: str, flag: BeamFlag) -> None:
    result = measured(tmp_path / "bench", fault)
    assert int(result.beams.flags[0]) & flag
    assert result.beams.reasons[0]
    assert result.doubts


@pytest.mark.slow
def test_corners_of_another_target_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="corners"):
        measured(tmp_path / "bench", "other-target")


@pytest.mark.slow
def test_times_of_another_zone_are_refused(tmp_path: Path) -> None:
    write_beam_dataset(tmp_path / "bench", BenchOptions(suns=3, faults=("local-time",)))
    result = compare.run(load_beams(tmp_path / "bench"), compare.CompareOptions(fit=False))
    # The morning's sun is set by then, or stands behind the mirror; what is left does not match.
    assert result.left_out
    assert any("UTC" in reason or "time zone" in reason for reason in result.left_out.values())


@pytest.mark.slow
def test_beams_while_the_sun_is_down_are_doubted(tmp_path: Path) -> None:
    """Local times stand as UTC: the last photo is taken at 22 h, long after sunset. Right times say nothing."""
    codes = [
        {one.code for one in measured(tmp_path / "-".join(("bench", *faults)), *faults, suns=2).doubts}
        for faults in (("local-time",), ())
    ]
    assert "beams_without_sun" in codes[0]
    assert "beams_without_sun" not in codes[1]


@pytest.mark.slow
def test_light_that_falls_towards_the_corners_is_said(tmp_path: Path) -> None:
    """A lens that loses 60 % in the corners."""
    result = measured(tmp_path / "bench", "vignetting")
    (fall,) = result.light_falls.values()
    # 0.3 (x^2 + y^2) of half the photo's width and height, 4 to 3: from 0.47 r^2 across to 0.83 r^2 up.
    assert 0.47 - 3 * fall.sigma_per_radius2 < fall.per_radius2 < 0.83 + 3 * fall.sigma_per_radius2
    numbers = result.summarise().numbers
    assert numbers["light_fall_over_target_share"] == pytest.approx(fall.over_target)
    # It moves the centre by less than its sigma, so nothing is said; with a calorimeter beside the beam it counts.
    truth = json.loads((tmp_path / "bench" / "truth.json").read_text())["photos"][0]
    off = np.hypot(result.beams.x_m[0] - truth["centroid_m"][0], result.beams.y_m[0] - truth["centroid_m"][1])
    assert off < 4 * float(np.hypot(*result.beams.sigma_m[0]))
    assert "light_falls_off" not in {one.code for one in result.doubts}
    x, y = truth["centroid_m"]
    file = tmp_path / "bench" / "measurement.toml"
    gauge = f"[flux]\ngauge_flux_w_m2 = 9000.0\ngauge_center_m = [{x}, {y}]\ngauge_diameter_m = 0.2\n"
    file.write_text(file.read_text() + gauge)
    (said,) = [one for one in run(load_beams(tmp_path / "bench")).doubts if one.code == "light_falls_off"]
    assert said.numbers["shift_m"] < 0.005


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Comparison, np.ndarray]]:
    found = []
    for seed in range(2):
        folder = tmp_path_factory.mktemp("bench") / "drawn"
        write_beam_dataset(folder, BenchOptions(suns=3, seed=seed))
        truth = np.array(json.loads((folder / "truth.json").read_text())["canting_rad"])
        found.append((compare.run(load_beams(folder)), truth))
    return found


@pytest.mark.slow
def test_canting_from_flux(fitted: list[tuple[Comparison, np.ndarray]]) -> None:
    errors, ratios = [], []
    for result, truth in fitted:
        assert result.after is not None
        error = result.after.canting_rad - truth
        errors.append(error)
        ratios.append(error / result.after.sigma_canting_rad)
        assert result.after.correlations.min() > result.before.correlations.min()
    assert np.sqrt(np.mean(np.square(errors))) < 1e-4
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 2.0


@pytest.mark.slow
def test_flux_of_a_measured_surface_is_that_of_the_photo(shared_data: Path) -> None:
    place = shared_data / "csp" / "juelich_surface"
    options = compare.CompareOptions(surface=place / "surfaces.h5", fit=False)
    result = compare.run(load_beams(place / "AA39" / "flux"), options)
    assert len(result.rows) == 3
    for row in result.rows:
        assert row.correlation > 0.95
        assert abs(row.d90_expected_m / row.d90_m - 1) < 0.05
        assert row.center_off_m < 0.1
    # A mirror that turns about the vertical instead of the east axis stands turned about its normal: seen at once.
    other = compare.run(
        load_beams(place / "AA39" / "flux"),
        compare.CompareOptions(options.surface, mount="azimuth-elevation", fit=False),
    )
    assert other.before.correlations.min() < result.before.correlations.min()


def test_records_of_the_plant_are_measured_or_refused_with_a_reason(shared_data: Path) -> None:
    """Five records of heliostat AA23 of the plant's own camera, with its labels."""
    result = run(load_beams(shared_data / "csp" / "juelich_beam_images"))
    assert len(result.photos.files) == 5
    refused = result.beams.rejected
    assert all(reason for reason, bad in zip(result.beams.reasons, refused, strict=True) if bad)
    assert np.count_nonzero(~refused) >= 4
    off = np.hypot(*result.offsets_m[~refused].T)
    assert off.max() < 0.1
    assert np.isfinite([one.sigma_diameters_m for one in result.beams.sizes]).all()


def test_a_second_beam_that_the_edge_cuts_is_said() -> None:
    """How much light of it is beyond the edge is not known; 4 % of the first is on the target, or 0.3 %."""
    own = 120 * gaussian((0.3, 0.2), (0.4, 0.6))
    for aside_m, said in ((3.85, True), (4.2, False)):
        other = 120 * gaussian((0.0, -aside_m), (0.4, 0.4))
        beam = measure_beam(picture(own + other + sky_light(), noise_dn=1.0))
        assert bool(beam.flags & BeamFlag.TWO_BEAMS) == said
        assert beam.rejected == said


@pytest.mark.slow
def test_crops_of_another_release_agree_with_its_labels(shared_data: Path) -> None:
    """139 crops of AA39: labels 1.626 m aside by the longitude that its README gives."""
    result = run(load_beams(shared_data / "csp" / "juelich_surface" / "AA39" / "beams"))
    used = ~result.beams.rejected
    assert all(reason for reason, bad in zip(result.beams.reasons, ~used, strict=True) if bad)
    assert np.count_nonzero(used) >= 125
    shift = np.radians(2.31243e-5) * 6.3906e6 * np.cos(np.radians(50.9134))
    (aside,) = (one for one in result.doubts if one.code == "labels_aside")
    assert aside.numbers == {"away_m": pytest.approx(1.629, abs=2e-3), "targets_count": 3}
    off = (result.offsets_m + [shift, 0.0])[used]
    assert np.hypot(*off.T).max() < 0.25
    assert 0.8 < np.sqrt(np.mean((off / result.beams.sigma_m[used]) ** 2)) < 1.25
    # A clear sky: daylight that bends is not taken for an aureole.
    assert np.mean((result.beams.flags[used] & np.uint32(BeamFlag.BACKGROUND_MAY_HOLD_LIGHT)) != 0) < 0.1


def test_a_canting_that_photos_do_not_tell_is_named() -> None:
    pair, none = np.zeros((2, 2)), np.zeros(0)
    for sigma_rad, told in ((0.3e-3, True), (0.6e-3, False)):
        sigma = np.full((2, 2), sigma_rad)
        found = FluxFit(pair, sigma, 0.0, 0.0, 1e-3, 1e-4, pair, pair, (), none, none, 1, np.zeros((4, 4)))
        assert found.is_canting_told == told
