"""Photos of dots drawn by tracing rays: slopes within their sigmas, the origin found, and wrong input named."""

import warnings
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_synth.dots import DotScene, dot_scene, photo_light, place_dots, write_dot_dataset
from deflectometry.dots.keys import load_dots
from deflectometry.dots.pipeline.measure import run
from deflectometry.pipeline.result import Result
from heliogauge.errors import EstimationError
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.tables import read_number_columns, write_table_csv
from heliogauge.validate import FloatArray

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene() -> DotScene:
    return dot_scene("small", "light")


@pytest.fixture(scope="module")
def folder(scene: DotScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drawn") / "in"
    write_dot_dataset(folder, scene)
    return folder


def _changed(folder: Path, out: Path, **pattern: object) -> Path:
    """Copy a measurement, with other keys of [pattern]."""
    out.mkdir()
    for name in ("photo.png", "dots.csv"):
        (out / name).write_bytes((folder / name).read_bytes())
    content = load_dots(folder).model.model_dump(mode="json", exclude_unset=True)
    content["pattern"] = {**content["pattern"], **pattern}
    write_measurement(out, content, comment="changed")
    return out


def _errors(result: Result, scene: DotScene) -> tuple[FloatArray, FloatArray]:
    """Return the errors of the dots' slopes and their sigmas, (n, 2); what is linear over the mirror is taken off.

    A pose that is a little off changes slopes by what is linear over the mirror; that share is in the common modes.
    """
    (image,) = result.evaluation.images.values()
    seen = np.isfinite(image.slope_x)
    x, y = image.x_m[seen], image.y_m[seen]
    _, true_x, true_y = scene.scene.facets[0].surface(x, y)
    error = np.stack([image.slope_x[seen] - true_x, image.slope_y[seen] - true_y], axis=1)
    linear = np.column_stack([np.ones(x.size), x, y])
    error -= linear @ np.linalg.lstsq(linear, error, rcond=None)[0]
    return error, np.stack([image.sigma_x[seen], image.sigma_y[seen]], axis=1)


def test_slopes_scatter_as_their_sigmas_say(scene: DotScene, folder: Path, tmp_path: Path) -> None:
    light = photo_light(scene, place_dots(scene, np.random.default_rng(0).spawn(3)[0]))
    normalised = []
    for seed in range(10):
        one = _changed(folder, tmp_path / str(seed))
        photo = scene.scene.sensor.expose(light, np.random.default_rng(100 + seed))
        cv2.imwrite(str(one / "photo.png"), photo)
        result = run(load_dots(one))
        error, sigma = _errors(result, scene)
        assert len(error) > 1000
        assert (np.sqrt(np.mean(error**2, axis=0)) < 0.03e-3).all()
        normalised.append(error / sigma)
    size = np.sqrt(np.mean(np.concatenate(normalised) ** 2, axis=0))
    assert (size > 0.8).all()
    assert (size < 1.25).all()


def test_unmarked_dots_are_placed_with_odds(scene: DotScene, folder: Path, tmp_path: Path) -> None:
    marked = run(load_dots(folder))
    assert not {one.code for one in marked.doubts} & {"dot_origin_open", "mirror_without_dots", "slopes_of_no_surface"}
    unmarked = run(load_dots(_changed(folder, tmp_path / "u", origin="unmarked")))
    open_place = next(one for one in unmarked.doubts if one.code == "dot_origin_open")
    assert 0.005 < open_place.numbers["place_probability"] < 0.9
    truly, likeliest = (one.evaluation.screen_map for one in (marked, unmarked))
    at = [np.argwhere(one.flags == 0).mean(axis=0) for one in (truly, likeliest)]
    off = np.abs(at[1] - at[0])[::-1]
    # The true place is within three of the stated RMS distances.
    assert (off <= 3 * np.array([open_place.numbers[f"{name}_off_count"] for name in ("columns", "rows")]) + 1).all()
    error, _ = _errors(unmarked, scene)
    assert (np.sqrt(np.mean(error**2, axis=0)) < 0.1e-3).all()


def test_half_of_the_dots_hidden_leaves_the_others(scene: DotScene, tmp_path: Path) -> None:
    write_dot_dataset(tmp_path / "half", replace(scene, hidden=0.5))
    result = run(load_dots(tmp_path / "half"))
    missing = next(one for one in result.doubts if one.code == "mirror_without_dots")
    assert missing.numbers["dotted_share"] == pytest.approx(result.numbers["measured_share"], abs=0.08)
    assert result.numbers["measured_share"] < 0.7
    error, _ = _errors(result, scene)
    assert (np.sqrt(np.mean(error**2, axis=0)) < 0.03e-3).all()


def test_a_light_that_is_not_there_is_missed(scene: DotScene, tmp_path: Path) -> None:
    write_dot_dataset(tmp_path / "dark", replace(scene, told_by="unmarked"))
    with pytest.raises(EstimationError, match="light at dot"):
        run(load_dots(_changed(tmp_path / "dark", tmp_path / "said", origin="light")))


@pytest.mark.parametrize(("name", "factors"), [("mirrored", (-1.0, 1.0)), ("wrong wall", (1.25, 1.25))])
def test_dots_of_another_wall_are_refused_or_named(
    folder: Path, tmp_path: Path, name: str, factors: tuple[float, float]
) -> None:
    wrong = _changed(folder, tmp_path / "wrong")
    column, row, x, y, z = read_number_columns(wrong / "dots.csv", ("column", "row", "x_m", "y_m", "z_m"))
    table = {"column": column.astype(int), "row": row.astype(int), "x_m": factors[0] * x, "y_m": factors[1] * y}
    write_table_csv(wrong / "dots.csv", {**table, "z_m": z})
    try:
        codes = {one.code for one in run(load_dots(wrong)).doubts}
    except EstimationError:
        codes = {"slopes_of_no_surface"}
    contradictions = {"slopes_of_no_surface", "slopes_too_far_off_design", "design_curvature_is_not_the_mirrors"}
    assert codes & (contradictions | {"setup_contradicts_slopes"}), name


def test_a_mirror_of_which_half_is_hidden_is_refused_in_a_sentence(folder: Path, tmp_path: Path) -> None:
    """The edge of what hides it is taken for the outline, and no shape agrees; nothing overflows on the way."""
    half = _changed(folder, tmp_path / "half")
    photo = cv2.imread(str(half / "photo.png"), cv2.IMREAD_UNCHANGED)
    photo[:, : photo.shape[1] // 2] = np.percentile(photo, 2)
    cv2.imwrite(str(half / "photo.png"), photo)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        with pytest.raises(EstimationError, match="nothing hides a part of the mirror"):
            run(load_dots(half))
