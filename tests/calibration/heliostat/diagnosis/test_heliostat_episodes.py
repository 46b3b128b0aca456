"""Episodes, few rows, physical bounds, targets that others do not see out of place: what a careful judge says."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.heliostat.diagnosis.bounds import is_physical
from calibration.heliostat.diagnosis.field_findings import judge_field
from calibration.heliostat.diagnosis.findings import Check, Diagnosis, Finding
from calibration.heliostat.diagnosis.full_diagnosis import FEW_ROWS
from tests.calibration.heliostat.diagnosis.test_heliostat_diagnosis import (
    SIGMA_M,
    TARGETS,
    beams,
    changed,
    drawn,
    hits,
    judged,
    nominal,
    seen,
)


@pytest.fixture
def rng():
    """Return a generator."""
    return np.random.default_rng(8)


def off_for_some_days(rng, level, days, *, count=72):
    """Return beams of a heliostat whose elevation was off on some of its days, and the rows concerned."""
    truth = drawn(nominal(), rng)
    observations = seen(truth, rng, count=count)
    group = observations.groups[0]
    dates = group.pointings.time.astype("datetime64[D]")
    rows = np.isin(dates, np.unique(dates)[days])
    names = np.array(group.target)
    readings, suns = group.pointings.readings, group.sun
    other = truth.with_value({"elevation_offset": truth.parameters.value("elevation_offset") + level})
    xy = np.where(rows[:, None], hits(other, readings, suns, names), hits(truth, readings, suns, names))
    xy += rng.normal(0, SIGMA_M, xy.shape)
    return beams(readings, suns, names, xy, group.pointings.time), rows


class TestEpisodes:
    def test_another_level_for_a_day_has_its_dates_and_its_size(self, rng):
        """47 mrad are 9 m of the beam: beyond the target, and no fault of target, scale or clock."""
        observations, rows = off_for_some_days(rng, 47e-3, [5])
        (finding,) = judged(observations).faults
        assert finding.kind == "episode"
        assert set(finding.rows) == set(np.flatnonzero(rows).tolist())
        assert finding.dates == tuple(np.unique(observations.time[rows].astype("datetime64[D]")).astype(str).tolist())
        # The offset adds to the angle that the reading is; the level is what has to be added to agree.
        assert abs(finding.evidence["level_2_rad"] - 47e-3) < 4 * finding.evidence["sigma_level_2_rad"]
        assert finding.chance < 1e-6
        assert "chance" in finding.doubt.text

    @pytest.mark.parametrize(("level", "severity"), [(1.8e-3, "rows"), (6e-3, "fault")])
    def test_what_drives_wander_anyhow_is_no_fault(self, rng, level, severity):
        """Zeros wander by half a milliradian, and rows of one day together: three times that on one of twelve days."""
        observations, rows = off_for_some_days(rng, level, [5])
        (finding,) = [one for one in judged(observations).findings if one.kind == "episode"]
        assert finding.severity == severity
        assert set(finding.rows) == set(np.flatnonzero(rows).tolist())
        assert (finding.chance > 0.01) is (severity == "rows")

    def test_at_the_end_nothing_came_back(self, rng):
        """A level that stays is a change on a date."""
        observations, _ = off_for_some_days(rng, 20e-3, [10, 11])
        assert judged(observations).kinds == ("change_point",)

    def test_outliers_of_one_day_that_agree_in_nothing_are_no_episode(self, rng):
        observations, _ = off_for_some_days(rng, 0.0, [5])
        group = observations.groups[0]
        dates = group.pointings.time.astype("datetime64[D]")
        rows = np.flatnonzero(dates == np.unique(dates)[5])
        spots = group.spot_m.copy()
        spots[rows] += rng.normal(0, 1.5, (rows.size, 1)) * TARGETS["upper"].axes[0]
        spots[rows] += rng.normal(0, 1.5, (rows.size, 1)) * TARGETS["upper"].axes[1]
        found = judged(changed(observations, spot_m=spots))
        assert "episode" not in [one.kind for one in found.findings if one.severity in ("fault", "rows")]


class TestFewRows:
    def test_what_few_rows_show_is_a_doubt(self, rng):
        """The same jump of the same heliostat: a fault of 72 rows, open with 16."""
        truth = drawn(nominal(), rng)
        later = truth.with_value({"azimuth_offset": truth.parameters.value("azimuth_offset") + 8e-3})
        many, few = (seen(truth, np.random.default_rng(3), count=count, later=later) for count in (72, FEW_ROWS - 4))
        assert judged(many).kinds == ("change_point",)
        found = judged(few)
        assert found.kinds == ()
        assert [one.severity for one in found.findings if one.kind == "change_point"] == ["doubt"]
        assert "change_point?" in found.named
        assert f"16 rows are too few to decide it: {FEW_ROWS} are needed" in found.doubts[0].text


class TestBounds:
    @pytest.mark.parametrize(
        ("kind", "value", "sigma", "physical"),
        [
            ("drift", 8e-3, 1e-3, True),
            ("drift", -0.110, 9e-3, False),
            ("sag", 5.99e-3, 1e-3, True),
            ("sag", 0.050, 1e-3, False),
            ("target_scale", 0.2, 0.01, True),
            ("target_scale", 1.0, 0.05, False),
        ],
    )
    def test_a_number_must_be_possible(self, kind, value, sigma, physical):
        assert is_physical(kind, np.array([value]), np.array([sigma])) is physical

    def test_spots_that_miss_in_metres_are_no_millimetres(self, rng):
        """Beams are steered to the middle: any miss divided by a thousand would lie there."""
        observations, rows = off_for_some_days(rng, 0.0, [3])
        spots = observations.groups[0].spot_m.copy()
        spots[rows] += (
            rng.choice([-1, 1], (rows.sum(), 1)) * rng.uniform(7.5, 12, (rows.sum(), 1)) * TARGETS["upper"].axes[0]
        )
        assert "units" not in judged(changed(observations, spot_m=spots)).named


def of_target(value, severity="fault"):
    """Return a diagnosis in which a target is out of place."""
    place = np.array(value)
    finding = Finding("target_place", severity, "It stands elsewhere.", {}, 1e-9, subject="target upper")
    checks = (Check("target_place", "target upper", 1e-9, 0.9, place, np.full(2, 0.05)),)
    return Diagnosis((finding,), checks, 0.01)


def sound(value=(0.0, 0.0), sigma=0.05):
    """Return a diagnosis without findings, and what it says of the target."""
    return Diagnosis(
        (), (Check("target_place", "target upper", 0.5, values=np.array(value), sigmas=np.full(2, sigma)),), 0.01
    )


class TestField:
    def test_a_target_out_of_place_for_all_is_one_finding(self):
        found = judge_field({"A": of_target((1.0, 0.2)), "B": of_target((1.05, 0.1)), "C": sound((0.9, 0.3))})
        (finding,) = found.findings
        assert (finding.kind, finding.heliostats) == ("target_place", ("A", "B", "C"))
        assert {name: one.kinds for name, one in found.changed.items()} == {"A": (), "B": ()}
        assert found.changed["A"].findings[0].severity == "field"

    def test_a_target_out_of_place_for_one_alone_is_open(self):
        found = judge_field({"A": of_target((1.0, 0.2)), "B": sound(), "C": sound()})
        assert found.findings == ()
        (finding,) = found.changed["A"].findings
        assert finding.severity == "doubt"
        assert "2 of 2 other heliostats that would see it do not" in finding.text

    def test_others_that_would_not_see_it_say_nothing(self):
        found = judge_field({"A": of_target((1.0, 0.2)), "B": sound(sigma=2.0)})
        assert not found.findings
        assert not found.changed

    def test_one_clock(self):
        def late(seconds):
            return Diagnosis((Finding("time_offset", "fault", "Late.", {"offset_s": seconds}, 0.0),), (), 0.01)

        found = judge_field({"A": late(3600.0), "B": late(3570.0), "C": late(-120.0)})
        (finding,) = found.findings
        assert finding.heliostats == ("A", "B")
        assert set(found.changed) == {"A", "B"}

    def test_one_day(self):
        """Three windows of a week within two years do not meet by chance; two of half a year do."""

        def jumped(*dates):
            return Diagnosis((Finding("change_point", "fault", "Jump.", {}, 0.0, dates=dates),), (), 0.01)

        week = {"A": ("2024-05-01", "2024-05-08"), "B": ("2024-05-03", "2024-05-06"), "C": ("2024-05-02", "2024-05-09")}
        found = judge_field({name: jumped(*dates) for name, dates in week.items()})
        assert found.findings[0].heliostats == ("A", "B", "C")
        half = {"A": ("2024-01-01", "2024-07-08"), "B": ("2024-05-03", "2024-12-06")}
        assert not judge_field({name: jumped(*dates) for name, dates in half.items()}).findings

    def test_what_is_compared_survives_being_written(self):
        old = of_target((1.0, 0.2))
        again = Diagnosis.from_content(old.content())
        assert again.content() == old.content()
        assert replace(again.findings[0], severity="doubt").severity == "doubt"
