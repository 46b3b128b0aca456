"""Several facets in one photo of dots: a lattice each, canting, and which lattices are one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.dots import DotScene, dot_scene, write_dot_dataset
from deflectometry.dots.facet_lattices import lattices_of_facets
from deflectometry.dots.found_dots import FoundDots
from deflectometry.dots.keys import load_dots
from deflectometry.dots.pipeline.measure import run
from heliogauge.errors import InputError
from heliogauge.measurement.writer import write_measurement
from heliogauge.validate import FloatArray
from tests.deflectometry.dots.known_dots import known_dots


def _lattice(places: FloatArray, number: FloatArray) -> FoundDots:
    count = len(places)
    covariance = np.tile(1e-4 * np.eye(2), (count, 1, 1))
    return FoundDots(places, covariance, number.astype(np.intp), np.full(count, 100.0), 1.0)


@pytest.mark.parametrize(("gap_px", "between", "surfaces"), [(30, True, 1), (30, False, 2), (14, False, 2)])
def test_rows_that_go_on_are_one_surface_where_dots_are_seen_between(gap_px: int, between: bool, surfaces: int) -> None:
    """Rows that meet across a true gap may do so a whole dot off: they are two lattices."""
    index = np.full((120, 220), -1, dtype=np.int16)
    index[5:115, 5:100], index[5:115, 100 + gap_px : 215] = 0, 1
    number = np.stack(np.meshgrid(np.arange(21), np.arange(11)), axis=-1).reshape(-1, 2)
    places = 10.0 * number + (8.0, 9.0)
    on_facet = index[places[:, 1].astype(int), places[:, 0].astype(int)] >= 0
    kept = on_facet | between
    found = lattices_of_facets([_lattice(places[kept], number[kept])], index, 1.0)
    assert len(found) == surfaces
    assert sorted(facet for one in found for facet in one.facets) == [0, 1]
    assert sum(len(one.dots.number) for one in found) >= np.count_nonzero(on_facet)


@pytest.fixture(scope="module")
def scene() -> DotScene:
    """Return two facets of the ensemble; the second shows the light."""
    drawn = dot_scene("ensemble", "light")
    return replace(drawn, scene=replace(drawn.scene, facets=drawn.scene.facets[3:5]))


@pytest.fixture(scope="module")
def folder(scene: DotScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drawn") / "in"
    write_dot_dataset(folder, scene)
    return folder


def _changed(folder: Path, out: Path, pattern: dict[str, object]) -> Path:
    out.mkdir()
    for name in ("photo.png", "dots.csv"):
        (out / name).write_bytes((folder / name).read_bytes())
    content = load_dots(folder).model.model_dump(mode="json", exclude_unset=True)
    write_measurement(out, content | {"pattern": pattern}, comment="changed")
    return out


@pytest.mark.slow
def test_a_facet_without_the_light_is_placed_by_the_others_with_odds(
    scene: DotScene, folder: Path, tmp_path: Path
) -> None:
    result = run(load_dots(folder))
    doubt = next(one for one in result.doubts if one.code == "dot_origin_open")
    assert scene.scene.facets[0].name in doubt.text
    assert scene.scene.facets[1].name not in doubt.text
    told = run(load_dots(_changed(folder, tmp_path / "told", {"dots": "dark", "known_dot": known_dots(scene)})))
    for facet in scene.scene.facets:
        one, other = (each.evaluation.images[facet.name].slope_x for each in (result, told))
        assert np.nanmax(np.abs(one - other)) < 1e-4
    wrong = [{"image_px": [3.0, 3.0]}]
    with pytest.raises(InputError, match="no facet shows dots"):
        run(load_dots(_changed(folder, tmp_path / "wrong", {"dots": "dark", "known_dot": wrong})))
