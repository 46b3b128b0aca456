"""The largest of many tries: none seen in white noise, below a bound that holds; true ones are still found."""

import numpy as np
import pytest
from scipy.stats import t

from calibration.heliostat.performance.entries import Conformity, Entry, Limit, decide
from calibration.heliostat.performance.extremes import largest_of
from calibration.heliostat.performance.files.result import read_entries, value_text, write_entries
from calibration.heliostat.performance.keys import load_tests
from calibration.heliostat.performance.pipeline.run_tests import run

SEEDS = 30
SIGMA_M = 0.02
#: From the mirror to the target's middle, and what a centimetre there is of the beam.
RANGE_M = float(np.linalg.norm([15.0, 120.0, 36.0]))
MEASUREMENT = """\
kind = "heliostat-tests"
name = "AB12"
date = 2026-06-25
[site]
latitude_deg = 37.09
longitude_deg = -2.36
[heliostat]
position_m = [15.0, 120.0, 4.0]
[target]
center_m = [0.0, 0.0, 40.0]
facing_azimuth_deg = 0.0
sigma_place_m = 0.02
[day]
file = "beams.csv"
[drift]
file = "beams.csv"
[repeat]
file = "beams.csv"
[sun_camera]
file = "angles.csv"
sigma_mrad = 0.1
"""
#: Entries that are the largest of many tries.
LARGEST = (
    "day_beam_largest_rad",
    "drift_right_beam_rad",
    "drift_up_beam_rad",
    "drift_sawtooth_right_beam_rad",
    "drift_sawtooth_up_beam_rad",
    "repeat_sides_right_beam_rad",
    "repeat_sides_up_beam_rad",
    "sun_camera_normal_largest_rad",
    "sun_camera_drift_right_normal_rad",
    "sun_camera_drift_up_normal_rad",
)
TIMES_S = np.arange(180) * 5.0


def measured(folder, places_m, rng):
    """Return the entries by name of a heliostat whose beams were seen at some places, and the sun where it should."""
    instants = np.datetime64("2026-06-22T11:10:00", "ms") + (1000 * TIMES_S).astype("timedelta64[ms]")
    seen = places_m + SIGMA_M * rng.standard_normal(places_m.shape)
    rows = [
        f"{time}Z,{x},{y},{SIGMA_M},{SIGMA_M},{side}"
        for time, (x, y), side in zip(instants, seen, np.resize(["east", "west", "up"], len(seen)), strict=True)
    ]
    (folder / "beams.csv").write_text("\n".join(["time_utc,x_m,y_m,sigma_x_m,sigma_y_m,approach", *rows]) + "\n")
    angles = 0.1 * rng.standard_normal((len(seen), 2))
    lines = [f"{time}Z,{a},{b}" for time, (a, b) in zip(instants, angles, strict=True)]
    (folder / "angles.csv").write_text("\n".join(["time_utc,azimuth_mrad,elevation_mrad", *lines]) + "\n")
    (folder / "measurement.toml").write_text(MEASUREMENT)
    return {one.name: one for one in run(load_tests(folder)).entries}


def test_white_noise_has_no_extremes(tmp_path):
    seen = []
    for seed in range(SEEDS):
        entries = measured(tmp_path, np.zeros((TIMES_S.size, 2)), np.random.default_rng(seed))
        seen += [name for name in LARGEST if entries[name].value is not None]
        for name in LARGEST:
            one = entries[name]
            assert one.value is not None or (one.below > 0 and value_text(one).startswith("none seen, below ")), name
    # One in a hundred, by chance.
    assert len(seen) <= 0.03 * SEEDS * len(LARGEST), seen


@pytest.mark.parametrize("height_m", [0.05, 0.15])
def test_true_sawteeth_are_found_though_the_period_is_not_stated(tmp_path, height_m):
    """0.4 and 1.2 mrad: 2.5 and 7.5 times the noise of a centre."""
    tooth = ((TIMES_S - 7.3) / 60.0) % 1.0 - 0.5
    scores = []
    for seed in range(6):
        entries = measured(tmp_path, np.outer(tooth, [height_m, 0.0]), np.random.default_rng(seed))
        found = entries["drift_sawtooth_right_beam_rad"]
        assert found.value is not None
        assert abs(float(found.note.split()[1]) - 60) < 0.4
        scores.append((found.value - height_m / RANGE_M) / found.sigma)
    assert np.sqrt(np.mean(np.square(scores))) < 2


def test_bound_of_a_sawtooth_holds(tmp_path):
    """One of the height of the bound is found in nearly all draws; the bound is no larger than needed."""
    entries = measured(tmp_path, np.zeros((TIMES_S.size, 2)), np.random.default_rng(0))
    below_m = entries["drift_sawtooth_right_beam_rad"].below * RANGE_M
    tooth = ((TIMES_S - 7.3) / 60.0) % 1.0 - 0.5
    found = {}
    for share in (0.4, 1.0):
        drawn = [
            measured(tmp_path, np.outer(tooth, [share * below_m, 0.0]), np.random.default_rng(seed))
            for seed in range(10)
        ]
        found[share] = sum(one["drift_sawtooth_right_beam_rad"].value is not None for one in drawn)
    assert found[1.0] >= 8
    assert found[0.4] <= 5


def test_bound_of_the_difference_between_sides_holds_for_few_approaches(tmp_path):
    """Two from each side leave two degrees of freedom, whose 95 % are 2.92 sigmas (Student's t), not 1.64."""
    measured(tmp_path, np.zeros((TIMES_S.size, 2)), np.random.default_rng(0))
    lines = (tmp_path / "beams.csv").read_text().splitlines()
    east, west = [0.010, 0.030], [0.012, 0.026]
    rows = [line.split(",") for line in lines[1:5]]
    for row, x, side in zip(rows, [*east, *west], ["east", "east", "west", "west"], strict=True):
        row[1], row[2], row[5] = str(x), "0.0", side
    (tmp_path / "few.csv").write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n")
    head, _, _ = MEASUREMENT.partition("[day]")
    (tmp_path / "measurement.toml").write_text(f'{head}[repeat]\nfile = "few.csv"\n')
    entries = {one.name: one for one in run(load_tests(tmp_path)).entries}
    sigma_m = np.sqrt((np.var(east, ddof=1) + np.var(west, ddof=1)) / 2)
    expected_m = abs(np.mean(east) - np.mean(west)) + t.ppf(0.95, 2) * sigma_m
    # Angles to the right are those of places seen on the slant.
    below = entries["repeat_sides_right_beam_rad"].below
    scatter = entries["repeat_right_beam_rad"]
    assert below > 0
    assert below == pytest.approx(expected_m / RANGE_M, rel=0.02), scatter


def test_readings_of_a_sun_camera_that_are_left_out_are_counted(tmp_path):
    measured(tmp_path, np.zeros((TIMES_S.size, 2)), np.random.default_rng(0))
    lines = (tmp_path / "angles.csv").read_text().splitlines()
    lines[5] = f"{lines[5].split(',')[0]},,0.1"
    lines[9] = f"{lines[8].split(',')[0]},0.1,0.1"
    (tmp_path / "angles.csv").write_text("\n".join(lines) + "\n")
    doubt = next(one for one in run(load_tests(tmp_path)).doubts if one.code == "sun_photos_left_out")
    assert "2 of 180 readings are left out (1 without an angle, 1 of the time of another)" in doubt.text


class TestLargest:
    @pytest.mark.parametrize("count", [10, 200])
    def test_noise_adds_to_the_largest_of_an_offset(self, count):
        """All beams are 2 mrad off: the largest of their centres is 2.3 sigma and more beyond."""
        off, sigma = np.tile([2e-3, 0.0], (count, 1)), np.full((count, 2), 0.3e-3)
        found = [
            largest_of(off + sigma * np.random.default_rng(seed).standard_normal(off.shape), sigma, np.zeros(2))
            for seed in range(40)
        ]
        assert all(one.is_seen for one in found)
        values = np.array([one.found.value for one in found])
        assert abs(values.mean() - 2e-3) < 0.1e-3
        assert np.mean([one.below > 2e-3 for one in found]) > 0.94

    def test_a_single_gust_keeps_its_size(self):
        rng = np.random.default_rng(1)
        sigma = np.full((100, 2), 0.3e-3)
        errors = sigma * rng.standard_normal((100, 2))
        errors[40] += [3e-3, 0.0]
        found = largest_of(errors, sigma, np.zeros(2))
        assert (found.index, found.is_seen) == (40, True)
        assert abs(found.found.value - 3e-3) < 3 * found.found.sigma

    def test_the_chance_is_that_of_the_largest_of_all(self):
        """A size that one place of 100 has by chance once in a thousand is no find."""
        sigma = np.full((100, 2), 1e-3)
        errors = np.full((100, 2), 1e-9)
        errors[3] = [1e-3 * np.sqrt(2 * np.log(1000)), 0.0]
        found = largest_of(errors, sigma, np.zeros(2))
        assert found.chance == pytest.approx(1 - (1 - 1e-3) ** 100, rel=1e-6)
        assert not found.is_seen


class TestNoneSeen:
    entry = Entry("drift", "sawtooth_right_beam_rad", "Sawtooth", None, below=0.8e-3)

    def test_it_is_written_and_read(self, tmp_path):
        write_entries(tmp_path / "entries.csv", "AB12", [self.entry])
        assert read_entries(tmp_path / "entries.csv") == ("AB12", (self.entry,))
        assert value_text(self.entry) == "none seen, below 0.8 mrad"

    @pytest.mark.parametrize(
        ("limit", "conformity"),
        [
            (Limit(most=1e-3), Conformity.PASS),
            (Limit(most=0.5e-3), Conformity.UNDECIDED),
            (Limit(least=0.1e-3, most=1e-3), Conformity.UNDECIDED),
        ],
    )
    def test_a_limit_above_the_bound_is_kept(self, limit, conformity):
        assert decide(self.entry, limit).conformity is conformity

    @pytest.mark.parametrize(
        ("confidence", "conformity"),
        [(0.9, Conformity.PASS), (0.95, Conformity.PASS), (0.951, Conformity.UNDECIDED), (0.99, Conformity.UNDECIDED)],
    )
    def test_a_bound_of_95_percent_shows_no_more(self, confidence, conformity):
        assert decide(self.entry, Limit(most=1e-3), confidence).conformity is conformity
