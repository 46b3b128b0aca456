"""One table of the sun for all who take one: as backward gazing writes it, as SolTrace has it."""

from pathlib import Path

import numpy as np
import pytest

from calibration.beam.keys import load_beams
from calibration.beam.pipeline import compare
from data_synth.heliostats import BenchOptions, write_beam_dataset
from deflectometry.gazing.pipeline.result import PROFILE_FILE
from deflectometry.gazing.planning.plan import run_folder
from deflectometry.gazing.sun_profile import SunProfile
from heliogauge.errors import InputError
from heliogauge.results.sun_tables import read_sun, write_sun
from tests.deflectometry.gazing.test_gazing import noisy_sun

PLAN = """
kind = "backward-gazing-plan"
name = "field"
[sun]
profile = "{file}"
[expected]
distance_m = 200.0
slope_error_mrad = 1.0
"""


def written(folder: Path) -> SunProfile:
    """The sun of a noisy photo with a sharp limb, as backward gazing writes it: some of it is below zero."""
    profile = noisy_sun(np.random.default_rng(1), sharp=True)[0].profile
    assert profile.relative.min() < 0
    write_sun(folder / PROFILE_FILE, profile.angle_rad, profile.relative)
    return profile


def test_a_measured_sun_is_that_of_the_beam_bench(tmp_path: Path) -> None:
    write_beam_dataset(tmp_path, BenchOptions(suns=1, seed=3))
    profile = written(tmp_path)
    toml = tmp_path / "measurement.toml"
    toml.write_text(toml.read_text().replace("[mirror]", f'[mirror]\nsun_file = "{PROFILE_FILE}"'))
    result = compare.run(load_beams(tmp_path), compare.CompareOptions(fit=False))
    assert PROFILE_FILE in result.sun
    expected = np.maximum(profile.relative, 0) / profile.relative[0]
    np.testing.assert_allclose(result.photos[0].sun.radiance(profile.angle_rad), expected, atol=1e-9)


@pytest.mark.parametrize("name", [PROFILE_FILE, "other.csv", "of_soltrace.sun"])
def test_any_sun_serves_a_plan_of_backward_gazing(name: str, tmp_path: Path) -> None:
    written(tmp_path)
    table = [line.split(",") for line in (tmp_path / PROFILE_FILE).read_text().splitlines()]
    named = [["angle_mrad", "relative_radiance"], *table[1:]]
    (tmp_path / "of_soltrace.sun").write_text("\n".join("\t".join(row) for row in table[1:]))
    (tmp_path / "other.csv").write_text("\n".join(",".join(row) for row in named))
    (tmp_path / "measurement.toml").write_text(PLAN.format(file=name))
    assert run_folder(tmp_path).best.measured_share > 0.5


def test_noise_beyond_the_limb_in_a_table_of_backward_gazing_is_darkness(tmp_path: Path) -> None:
    (tmp_path / "sun.csv").write_text("angle_mrad,relative_radiance\n0,1\n4,0.5\n5,-0.002\n6,0.001\n7,-0.001\n")
    sun = read_sun(tmp_path / "sun.csv")
    np.testing.assert_array_equal(sun.radiance(1e-3 * np.array([0.0, 4, 5, 6, 7])), [1, 0.5, 0, 0.001, 0])


def test_radiance_of_any_unit_below_zero_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sun.csv").write_text("angle_mrad,radiance\n0,1\n4,0.5\n5,-0.002\n")
    with pytest.raises(InputError, match="no sun shape"):
        read_sun(tmp_path / "sun.csv")


def test_what_is_no_sun_is_named(tmp_path: Path) -> None:
    (tmp_path / "sun.csv").write_text("angle_mrad,flux\n0,10\n4,9\n")
    with pytest.raises(InputError, match=r"sun\.csv: the column radiance is missing; it has angle_mrad, flux"):
        read_sun(tmp_path / "sun.csv")
