"""[surface] of a photogrammetric measurement: recovery of a known panel through the files, two dates, bad input."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.targets.dataset import PhotoOptions, photogrammetry_content, write_target_dataset
from data_synth.targets.presets import PrintChoice, target_scene
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.instruments import read_resource
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.writer import dump_toml
from heliogauge.results.folder import facet_names, read_slope_map, read_summary, read_table_csv
from heliogauge.slopes.statistics import statistics
from heliogauge.view.arrays import PAGE
from photogrammetry.keys.load import load_photogrammetry
from photogrammetry.keys.surface import SurfaceSection
from photogrammetry.pipeline.headline import headline_text
from photogrammetry.pipeline.measure import run
from photogrammetry.pipeline.result import Result
from photogrammetry.pipeline.surface import measure_surface
from photogrammetry.report.network import open_network
from photogrammetry.report.surface import surface

FOCAL_M = 1.5
TILT_RAD = 2e-3
FACETS = {"low": lambda x, y: y < 0, "high": lambda x, y: y >= 0}


def panel(folder: Path, moved: dict[str, list[float]], seed: int) -> Path:
    """Write image points of a paraboloid of which the upper half is tilted in x, with the design's coordinates."""
    scene = target_scene("small", 0, PrintChoice())
    sheets = []
    for sheet in scene.sheets:
        x, y, _ = sheet.world_from_sheet.translation_m
        z = (x * x + y * y) / (4 * FOCAL_M) + (TILT_RAD * x if y >= 0 else 0.0)
        place = np.array([x, y, z]) + moved.get(sheet.name, [0, 0, 0])
        sheets.append(replace(sheet, world_from_sheet=RigidTransform(sheet.world_from_sheet.rotation, place)))
    scene = replace(scene, sheets=tuple(sheets))
    points = scene.points_m()
    lengths = tuple(
        replace(one, length_m=(length := float(np.linalg.norm(points[one.a] - points[one.b]))), stated_m=length)
        for one in scene.lengths
    )
    scene = replace(scene, lengths=lengths)
    write_target_dataset(folder, scene, photogrammetry_content(scene), PhotoOptions(seed, 0.02))
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return panel(tmp_path_factory.mktemp("surface") / "panel", {}, 3)


@pytest.fixture(scope="module")
def truth(folder: Path) -> dict[str, np.ndarray]:
    return {k: np.array(v) for k, v in json.loads((folder / "truth.json").read_text())["points_m"].items()}


@pytest.fixture(scope="module")
def adjusted(folder: Path) -> Result:
    return run(load_photogrammetry(folder))


def references(truth: dict[str, np.ndarray]) -> list[dict]:
    return [{"target": name, "xyz_m": truth[name].tolist()} for name in ("1", "4", "8", "17")]


def section(**keys) -> SurfaceSection:
    # Read as from a file: tuples are lists there.
    return SurfaceSection.model_validate_json(json.dumps(keys))


def measured(adjusted: Result, folder: Path, **keys):
    return measure_surface(section(**keys), folder, adjusted.solved.bundle)


def test_facets_show_their_canting_and_the_map_shows_it_too(adjusted, folder, truth) -> None:
    names = {side: [n for n, p in truth.items() if inside(*p[:2])] for side, inside in FACETS.items()}
    found = measured(
        adjusted,
        folder,
        design="paraboloid",
        focal_length_m=FOCAL_M,
        fit="none",
        reference=references(truth),
        facet=[{"name": side, "targets": targets} for side, targets in names.items()],
    )
    canting = {one.name: one for one in found.cantings}
    for side, expected in (("low", 0.0), ("high", TILT_RAD)):
        one = canting[side]
        assert one.canting[0] == pytest.approx(expected, abs=4 * one.sigma_canting[0] + 1e-5)
        assert one.canting[1] == pytest.approx(0, abs=4 * one.sigma_canting[1])
        assert one.length_m == pytest.approx(FOCAL_M, abs=4 * one.sigma_length_m + 2e-4)
        part = found.slopes.patches[side]
        error = float(np.mean(part.slope_error_x[part.valid]))
        assert error == pytest.approx(expected, abs=1e-4)
    assert set(found.facet_of) == {"low", "high"}
    # Place is given by four of the targets: z and slopes are those of the design's frame.
    xyz = np.array([truth[name] for name in found.fit.points.ids])
    ratio = (found.fit.points.points_m - xyz) / found.fit.points.sigma_m
    known = np.isin(found.fit.points.ids, ["1", "4", "8", "17"])
    assert np.sqrt(np.mean(ratio[~known] ** 2)) == pytest.approx(1, abs=0.4)


def test_facets_with_designs_of_their_own_are_placed_by_their_pose(adjusted, folder, truth) -> None:
    # The same paraboloid, said as two designs: once in the frame of the whole, once seen from half a metre aside.
    shift = [0.5, 0.0, 0.5**2 / (4 * FOCAL_M)]
    aside = {
        "design": "quadric",
        "position_m": shift,
        "coefficients": [1 / (4 * FOCAL_M), 1 / (4 * FOCAL_M), 0.5 / (2 * FOCAL_M), 0.0, 0.0, 0.0],
    }
    own = {"design": "paraboloid", "focal_length_m": FOCAL_M}
    names = {side: [n for n, p in truth.items() if inside(*p[:2])] for side, inside in FACETS.items()}
    facets = [{"name": "low", "targets": names["low"], **own}, {"name": "high", "targets": names["high"], **aside}]
    found = measured(adjusted, folder, fit="none", reference=references(truth), facet=facets)
    low, high = found.cantings
    assert low.canting[0] == pytest.approx(0.0, abs=4 * low.sigma_canting[0] + 1e-5)
    assert high.canting[0] == pytest.approx(TILT_RAD, abs=4 * high.sigma_canting[0] + 1e-5)
    assert np.isnan(high.length_m)
    with pytest.raises(InputError, match="designs of their own; name three or more"):
        measured(adjusted, folder, facet=facets)


@pytest.mark.slow
def test_focal_length_of_one_half_is_recovered(adjusted, folder, truth) -> None:
    names = [name for name, place in truth.items() if place[1] < 0]
    found = measured(adjusted, folder, design="paraboloid", focal_length_m=1.7, fit="focal-length", targets=names)
    length, sigma, _ = found.fit.parameters.lengths()["focal_length_m"]
    assert length == pytest.approx(FOCAL_M, abs=4 * sigma)
    assert sigma < 0.01
    assert found.fit.rms_deviation_m < 5e-5


@pytest.mark.slow
def test_files_and_headline(folder: Path, truth, tmp_path: Path) -> None:
    content = tomllib.loads((folder / "measurement.toml").read_text())
    names = {side: [n for n, p in truth.items() if inside(*p[:2])] for side, inside in FACETS.items()}
    content["surface"] = {
        "design": "paraboloid",
        "focal_length_m": FOCAL_M,
        "reference": references(truth),
        "grid_step_mm": 50.0,
        "facet": [{"name": side, "targets": targets} for side, targets in names.items()],
    }
    own = tmp_path / "own"
    own.mkdir()
    (own / "measurement.toml").write_text(dump_toml(content))
    (own / "image_points.csv").write_bytes((folder / "image_points.csv").read_bytes())
    out = tmp_path / "out"
    out.mkdir()
    run(load_photogrammetry(own)).write(out)
    assert facet_names(out / "slope_map.nc") == ("low", "high")
    whole = read_slope_map(out / "slope_map.nc")
    assert np.diff(whole.x_m) == pytest.approx(0.05)
    numbers = read_summary(out / "summary.json").numbers
    # Read back in float32.
    assert numbers["sdx_rad"] == pytest.approx(statistics(whole).sdx_rad, rel=1e-3)
    # The rigid fit shares the tilt of one half between both: half of it each.
    assert numbers["canting_rms_x_rad"] == pytest.approx(TILT_RAD / 2, rel=0.1)
    rows = read_table_csv(out / "surface.csv")
    deviations = np.array(rows["deviation_m"], dtype=float)
    assert numbers["deviation_rms_m"] == pytest.approx(float(np.sqrt((deviations**2).mean())), rel=0.05)
    assert read_table_csv(out / "canting.csv")["facet"] == ["low", "high"]
    said = headline_text(read_summary(out / "summary.json"))
    assert "canting          2 facets, RMS x 0.98" in said
    assert "SDx " in said
    shown = surface(open_network(out))
    page = shown.text
    # Deviations from above and from the side, slope errors in x and y, canting; in a page views are alive.
    assert page.count("<img") == 5
    alive = shown.page_html(PAGE)
    assert [alive.count(f'data-view="{kind}"') for kind in ("scene", "map", "table")] == [1, 1, 1]
    assert "<h3>Canting</h3>" in page
    assert "low" in page


def test_two_dates_show_what_moved(adjusted, folder, truth, tmp_path: Path) -> None:
    # The scale bars' ends stay; sideways moves would be lost in a comparison of heights.
    moved = {"12": [0.0, 0.0005, 0.0], "20": [0.0, 0.0, -0.001]}
    later = run(load_photogrammetry(panel(tmp_path / "later", moved, 4)))
    earlier = tmp_path / "earlier"
    earlier.mkdir()
    adjusted.write(earlier)
    found = measure_surface(section(compare_with=str(earlier)), folder, later.solved.bundle)
    assert {name for name, one in zip(found.moved.ids, found.moved.moved, strict=True) if one} == {"12", "20"}
    size = np.linalg.norm(found.moved.displacement_m, axis=1)
    sizes = dict(zip(found.moved.ids, size, strict=True))
    assert sizes["20"] == pytest.approx(0.001, abs=1e-4)
    assert sizes["12"] == pytest.approx(0.0005, abs=1e-4)
    assert found.fit is None


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"design": "plane", "targets": ["nothing*"]}, "'nothing\\*' is no measured target"),
        (
            {"design": "plane", "facet": [{"name": "a", "targets": ["1..9"]}, {"name": "b", "targets": ["9"]}]},
            'target 9 is in "a" and in "b"',
        ),
        ({"compare_with": "elsewhere"}, "must be a folder of results"),
        ({"mesh": "part.stl"}, "no such mesh"),
        (
            {"design": "plane", "reference": [{"target": t, "xyz_m": [0.0, 0.0, 0.0]} for t in ("1", "2", "absent")]},
            "absent are not among",
        ),
    ],
)
def test_what_is_asked_wrongly_is_refused(adjusted, folder, keys, words) -> None:
    with pytest.raises(InputError, match=words):
        measured(adjusted, folder, **keys)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fit = 'rigid'", "design is missing"),
        ("design = 'plane'\nfit = 'focal-length'", "needs one design with a focal length"),
        ("design = 'plane'\nmesh = 'a.stl'", "both given"),
        ("design = 'plane'\nstable_targets = ['1']", "compare_with, which is missing"),
        ("design = 'paraboloid'", "needs focal_length_m"),
        ("design = 'plane'\nmirror = 1", "mirror"),
    ],
)
def test_section_is_checked_before_any_work(folder: Path, text: str, words: str) -> None:
    content = tomllib.loads((folder / "measurement.toml").read_text()) | {"surface": tomllib.loads(text)}
    with pytest.raises(InputError, match=words):
        parse_measurement(content, folder / "measurement.toml")


def test_keys_of_the_template_are_keys_of_the_section() -> None:
    template = read_resource("photogrammetry:template.toml")
    content = tomllib.loads(template[template.index("# The surface under the targets") :].replace("#: ", ""))
    SurfaceSection.model_validate_json(json.dumps(content["surface"]))
    shown = set(content["surface"]) | {"mesh", "mesh_unit"}
    # Keys of other shapes, and where on its optic a facet sits, stand in the page.
    hidden = {
        "focal_length_x_m",
        "focal_length_y_m",
        "radius_m",
        "coefficients",
        "design_center_m",
        "design_orientation",
    }
    assert shown | hidden == set(SurfaceSection.model_fields)
