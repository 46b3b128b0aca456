"""What measurement.toml leaves out of the collector: panels, supports; targets that cannot be its own."""

import tomllib

import pytest

from heliogauge.instruments import read_resource
from observer.doubts.stated_collector import far_targets_doubt, panels_doubts, supports_doubt
from observer.keys import TroughSection
from observer.pipeline.inputs import build_collector
from photogrammetry.keys import CoordinateSection

SIZES = {"aperture_width_m": 5.76, "length_m": 6.86, "focal_length_m": 1.71, "absorber_diameter_mm": 70.0}
X = [-2.88, -1.46, 0.0, 1.46, 2.88]
Y = [-3.43, -1.715, 0.0, 1.715, 3.43]


def section(**stated: object) -> TroughSection:
    return TroughSection.model_validate({**SIZES, **stated})


@pytest.mark.parametrize(
    ("stated", "named"),
    [
        ({"panel_edges_x_m": X, "panel_edges_y_m": Y}, ""),
        ({}, "collector.panel_edges_x_m and panel_edges_y_m not stated"),
        ({"panel_edges_x_m": X}, "collector.panel_edges_y_m not stated"),
        ({"panel_edges_y_m": Y}, "collector.panel_edges_x_m not stated"),
        # One panel, said in so many words.
        ({"panel_edges_x_m": [], "panel_edges_y_m": []}, ""),
        # Smaller than panels are.
        ({"aperture_width_m": 1.9, "length_m": 1.6, "focal_length_m": 0.6}, ""),
        ({"aperture_width_m": 2.1, "length_m": 1.6, "focal_length_m": 0.6}, "collector.panel_edges_x_m not stated"),
    ],
)
def test_a_mirror_of_which_no_panels_are_stated_is_named(stated: dict[str, object], named: str) -> None:
    found = [one.text for one in panels_doubts(section(**stated)) if one.code == "one_panel_assumed"]
    assert [text.split(":")[0] for text in found] == ([named] if named else [])


@pytest.mark.parametrize(
    ("edges", "left_m"),
    [
        (X, None),
        # Rims of 0.1 m beyond the glass; one panel measured alone.
        ([-2.78, -1.46, 0.0, 1.46, 2.78], None),
        ([0.0, 1.46], None),
        ([-1.46, 0.0, 1.46], 1.42),
        ([-2.88, -1.46, 0.0, 1.46], 1.42),
    ],
)
def test_edges_that_lack_the_outer_ones_are_named(edges: list[float], left_m: float | None) -> None:
    found = list(panels_doubts(section(panel_edges_x_m=edges, panel_edges_y_m=Y)))
    assert [one.numbers["left_out_m"] for one in found] == ([] if left_m is None else [pytest.approx(left_m)])
    assert {one.code for one in found} <= {"panel_edges_end_inside"}


def test_supports_that_nobody_stated_are_named_and_none_that_is_stated_is_not() -> None:
    found = supports_doubt(section())
    assert found is not None
    assert "support_y_m not stated" in found.text
    assert supports_doubt(section(support_y_m=[])) is None
    assert supports_doubt(section(support_y_m=[-3.43, 0.0, 3.43])) is None


@pytest.mark.parametrize(
    ("unit", "moved_m", "far"), [(1.0, 0.0, 0), (1e3, 0.0, 4), (100.0, 0.0, 4), (1.0, 6.5, 0), (1.0, 9.0, 2)]
)
def test_targets_in_other_units_or_of_another_row_are_named(unit: float, moved_m: float, far: int) -> None:
    """Moved across by more than the collector's length the two on one side are another's, the others stand nearer."""
    places = {"1": (-3.06, -3.28, 1.21), "2": (-3.06, 3.28, 1.21), "3": (3.06, -3.28, 1.21), "4": (3.06, 3.28, 1.21)}
    coordinates = [
        CoordinateSection(kind="coordinate", target=name, axis=axis, value_m=unit * value + moved, sigma_mm=1.0)
        for name, place in places.items()
        for axis, value, moved in zip("xyz", place, (moved_m, 0.0, 0.0), strict=True)
    ]
    found = far_targets_doubt(coordinates, build_collector(section()))
    assert (0 if found is None else found.numbers["far_count"]) == far


def test_the_template_asks_for_panels_and_supports_beside_the_keys_that_must_be() -> None:
    text = read_resource("observer:template.toml")
    lines = text[text.index("[collector]") : text.index("[camera]")].splitlines()
    told = next(number for number, line in enumerate(lines) if line.startswith("# State these too"))
    asked = ("panel_edges_x_m", "panel_edges_y_m", "panel_gap_mm", "support_y_m", "support_width_m")
    assert [line.split()[1] for line in lines[told:] if line.startswith("#: ")][: len(asked)] == list(asked)
    # As keys they are what the collector can be built from.
    stated = tomllib.loads("\n".join(line.removeprefix("#: ") for line in lines))["collector"]
    assert build_collector(TroughSection.model_validate(stated)).n_panels == 20
