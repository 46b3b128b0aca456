"""Rows of tables that have no part in a measurement are counted in a doubt."""

from observer.pipeline.inputs import Tables, left_out_doubts

ABSORBER = {name: ["0", "1", "2"] for name in ("y_m", "x_a_m", "z_a_m", "sigma_x_a_m", "sigma_z_a_m")}
TARGETS = {name: ["a", "b"] if name == "target" else ["1", "2"] for name in ("target", "x_m", "y_m", "z_m", "sigma_mm")}


def codes(tables: Tables) -> dict[str, float]:
    return {one.code: one.numbers["left_out_count"] for one in left_out_doubts(tables)}


def test_whole_tables() -> None:
    assert codes(Tables(TARGETS, ABSORBER, None)) == {}
    assert codes(Tables(TARGETS, None, None)) == {}


def test_stations_with_empty_cells() -> None:
    absorber = {**ABSORBER, "x_a_m": ["", "1", "nan"]}
    assert codes(Tables(TARGETS, absorber, None)) == {"absorber_stations_left_out": 2}


def test_coordinates_without_sigma() -> None:
    assert codes(Tables({**TARGETS, "sigma_mm": ["", "1"]}, None, None)) == {"coordinates_left_out": 3}
    apart = {name: TARGETS[name] for name in ("target", "x_m", "y_m", "z_m")}
    sigmas = {"sigma_x_mm": ["", "1"], "sigma_y_mm": ["1", "1"], "sigma_z_mm": ["1", "1"]}
    assert codes(Tables({**apart, **sigmas}, None, None)) == {"coordinates_left_out": 1}


def test_a_coordinate_that_is_not_known_is_no_row_left_out() -> None:
    assert codes(Tables({**TARGETS, "x_m": ["", "1"], "sigma_mm": ["1", "1"]}, None, None)) == {}
