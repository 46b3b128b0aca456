"""Intercept factor in the pipeline: sun of measurement.toml, numbers for summary.json, curves as tables."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.measurement.templates import write_template
from heliogauge.results.folder import Summary, write_summary
from heliogauge.results.sun_tables import read_sun
from heliogauge.results.tables import read_table_csv
from heliogauge.sunlight.sun_shapes import BuieSun, GaussianSun, PillboxSun, SunShape, TabulatedSun
from observer.keys import ObserverModel, OpticsSection, SunSection
from observer.light.cases import Case
from observer.light.trace import Sunlight
from observer.pipeline.inputs import build_sun
from observer.pipeline.intercept import (
    OFFSETS_RAD,
    InterceptResult,
    evaluate_intercept,
    intercept_numbers,
    write_intercept,
)
from observer.product.panel_alignment import PanelTilts
from observer.trough.absorber_path import AbsorberPath
from tests.observer.drawn_trough import SOLTRACE, gaussian_errors, slope_map

#: One panel, turned by 3 mrad.
TILTED = PanelTilts(np.zeros(1), np.zeros(1), np.array([3e-3]), np.array([1e-4]), np.ones(1))


def model(**sections: object) -> ObserverModel:
    return ObserverModel.model_validate(
        {
            "kind": "observer",
            "name": "collector",
            "collector": {
                "aperture_width_m": 5.774,
                "length_m": 4.0,
                "focal_length_m": 1.71,
                "absorber_diameter_mm": 70.0,
            },
            "images": {"photos": "*.png"},
            "targets": {"dictionary": "aicon-12", "diameter_mm": 60.0},
            **sections,
        }
    )


def absorber(x_m: float = 3e-3, z_m: float = 1.703) -> AbsorberPath:
    return AbsorberPath(np.array([-2.0, 2.0]), np.full(2, x_m), np.full(2, z_m), 1e-8 * np.eye(4))


def result(folder: Path) -> InterceptResult:
    mirror = slope_map(gaussian_errors(3e-3, (60, 80)), sigma=1e-4)
    slopes = np.array(mirror.slope_x)
    slopes[:6] = np.nan
    given = model()
    light = Sunlight(build_sun(given.sun, None), 1e-3, 2e-3)
    return evaluate_intercept(light, replace(mirror, slope_x=slopes), absorber(), SOLTRACE, TILTED)


def columns(path: Path) -> dict[str, np.ndarray]:
    return {name: np.array(cells, dtype=np.float64) for name, cells in read_table_csv(path, ()).items()}


def tabulated(folder: Path, name: str = "sun.csv") -> SunShape:
    return build_sun(SunSection(shape="table", file=name), read_sun(folder / name))


def test_sun_is_what_the_file_says(tmp_path: Path) -> None:
    (tmp_path / "sun.csv").write_text("angle_mrad,radiance\n0,10\n4,9\n5,0.5\n20,0\n")
    table = tabulated(tmp_path)
    assert isinstance(table, TabulatedSun)
    np.testing.assert_allclose(table.radiance([0.0, 4e-3, 12.5e-3]), [1.0, 0.9, 0.025])
    gauss = build_sun(SunSection(), None)
    assert isinstance(gauss, GaussianSun)
    assert gauss.sigma_rad == pytest.approx(2.73e-3)
    pillbox = build_sun(SunSection(shape="pillbox", half_angle_mrad=4.7), None)
    assert isinstance(pillbox, PillboxSun)
    assert pillbox.limit_rad == pytest.approx(4.7e-3)
    buie = build_sun(SunSection(shape="buie", circumsolar_ratio=0.2), None)
    assert isinstance(buie, BuieSun)
    assert buie.circumsolar_share == pytest.approx(0.2, abs=1e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("angle_mrad,radiance\n0,ten\n4,9\n", "decimal sign"),
        ("angle_mrad,radiance\n4,10\n0,9\n", "ascending"),
        ("angle_mrad,flux\n0,10\n4,9\n", "radiance"),
    ],
)
def test_a_table_that_is_no_sun_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "sun.csv").write_text(text)
    with pytest.raises(InputError, match=message) as found:
        tabulated(tmp_path)
    assert "sun.csv" in str(found.value)


def test_suns_of_soltrace_are_read_as_tables(tmp_path: Path, shared_data: Path) -> None:
    (tmp_path / "mine.sun").write_text("0.0\t10\n4.0\t9\n\n5.0 0.5\n20 0\n")
    np.testing.assert_allclose(tabulated(tmp_path, "mine.sun").radiance([0.0, 4e-3, 12.5e-3]), [1.0, 0.9, 0.025])
    for text, said in (("", "the file is empty"), ("0 1 2\n", "row 1 has 3"), ("0 1\n4\n", "row 2 has 1")):
        (tmp_path / "bad.sun").write_text(text)
        with pytest.raises(InputError, match=said):
            tabulated(tmp_path, "bad.sun")
    folder = shared_data / "csp" / "soltrace"
    if not folder.is_dir():
        pytest.skip("SolTrace's files (../shared/data/csp/soltrace) are not on this machine")
    for name, share in (("CSR10.sun", 0.10), ("CSR40.sun", 0.40)):
        assert 1 - tabulated(folder, name).share_within(4.65e-3) == pytest.approx(share, abs=0.03)


def test_numbers_fit_each_other_and_the_summary(tmp_path: Path) -> None:
    found = result(tmp_path)
    numbers, why = intercept_numbers(found)
    assert why == {}
    write_summary(tmp_path / "summary.json", Summary(kind="observer", name="collector", numbers=numbers))
    value = {key: number for key, number in numbers.items() if number is not None}
    for case in ("absorber_aligned", "mirror_perfect"):
        rest = value[f"intercept_{case}_ratio"] - value["intercept_ratio"]
        assert value[f"intercept_gain_{case}_ratio"] == pytest.approx(rest, abs=1e-12)
        assert rest > 0
    assert value["intercept_traced_ratio"] == pytest.approx(value["intercept_ratio"], abs=4e-4)
    assert value["intercept_short_form_ratio"] == pytest.approx(value["intercept_ratio"], abs=2e-3)
    assert value["intercept_rest_lost_ratio"] == pytest.approx(0.9 * value["intercept_ratio"], abs=2e-3)
    assert value["intercept_rest_caught_ratio"] == pytest.approx(value["intercept_rest_lost_ratio"] + 0.1)
    assert value["best_absorber_shift_x_m"] == pytest.approx(-3e-3, abs=4e-4)
    assert value["best_absorber_shift_z_m"] == pytest.approx(7e-3, abs=4e-4)
    assert value["intercept_best_absorber_ratio"] >= value["intercept_ratio"]
    assert value["intercept_best_tracking_ratio"] >= value["intercept_ratio"]
    assert "10.0 %" in found.assumption
    assert "specularity 1 mrad" in found.light


def test_no_gain_is_said_for_a_place_that_is_not_determined(tmp_path: Path) -> None:
    found = result(tmp_path)
    assert found.shift is not None
    flat = replace(found, shift=replace(found.shift, covariance=np.full((2, 2), np.inf)))
    numbers, why = intercept_numbers(flat)
    for key in ("best_absorber_shift_x_m", "best_absorber_shift_z_m", "intercept_best_absorber_ratio"):
        assert numbers[key] is None
        assert "flat" in why[key]


def test_curves_are_written_as_tables(tmp_path: Path) -> None:
    found = result(tmp_path)
    write_intercept(found, tmp_path)
    curve = columns(tmp_path / "intercept.csv")
    np.testing.assert_allclose(curve["tracking_offset_rad"], OFFSETS_RAD, atol=1e-12)
    middle = int(np.argmin(np.abs(OFFSETS_RAD)))
    assert curve["intercept_ratio"][middle] == pytest.approx(found.cases[Case.AS_MEASURED].ratio[0])
    assert curve["intercept_ratio"][0] < curve["intercept_ratio"][middle] - 0.05
    tilted = columns(tmp_path / "intercept_incidence.csv")
    assert (np.diff(tilted["intercept_ratio"]) < 0).all()
    assert (tilted["sigma_intercept_ratio"] > 0).all()
    spread = columns(tmp_path / "beam_spread.csv")
    step = spread["angle_rad"][1] - spread["angle_rad"][0]
    assert spread["error_density_per_rad"].sum() * step == pytest.approx(1.0, abs=1e-6)
    assert spread["beam_density_per_rad"].sum() * step == pytest.approx(1.0, abs=1e-6)


def test_an_absorber_away_from_the_light_is_said() -> None:
    mirror = slope_map(gaussian_errors(1e-3, (20, 40)))
    found = evaluate_intercept(Sunlight(GaussianSun(2.73e-3)), mirror, absorber(0.09, 1.71), SOLTRACE, TILTED)
    numbers, why = intercept_numbers(found)
    assert found.doubts != ()
    assert numbers["best_tracking_offset_rad"] is None
    assert "warnings" in why["best_tracking_offset_rad"]


def test_template_shows_the_keys_of_the_light(tmp_path: Path) -> None:
    text = write_template("observer", tmp_path).read_text()
    light = text[text.index("#: [sun]") : text.index("#: [evaluation]")].replace("#: ", "")
    sections = tomllib.loads(light)
    given = model(**sections)
    assert given.sun == SunSection()
    assert given.optics == OpticsSection()
    assert sections.keys() == {"sun", "optics"}
