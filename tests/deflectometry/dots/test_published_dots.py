"""The published photo of dots in a facet: origin unaided, and slopes with the publisher's pose and dots."""

from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
from scipy.spatial import cKDTree

from deflectometry.dots.keys import load_dots
from deflectometry.dots.pipeline.measure import run
from deflectometry.exchange.opencsp_import import OpencspOptions, import_opencsp
from deflectometry.pipeline.result import Result
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.writer import write_measurement
from heliogauge.validate import FloatArray

pytestmark = pytest.mark.slow


def _published(data: Path) -> tuple[FloatArray, FloatArray]:
    """Return the publisher's points (n, 3) and slopes (n, 2)."""
    with h5py.File(data / "fixed" / "expected" / "calculation_facet.h5") as file:
        solved = file["DataSofastCalculation/facet/facet_000/SlopeSolverData"]
        return solved["v_surf_points_facet"][()].T, solved["slopes_facet_xy"][()].T


def _measured(result: Result) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the dots' points (n, 2), slopes (n, 2) and places in the photo (n, 2)."""
    (image,) = result.evaluation.images.values()
    row, column = np.nonzero(np.isfinite(image.slope_x))
    points = np.stack([image.x_m, image.y_m], axis=-1)[row, column]
    slopes = np.stack([image.slope_x, image.slope_y], axis=-1)[row, column]
    return points, slopes, image.grid.pixels_px(row + image.row, column + image.column)


@pytest.fixture(scope="module")
def folder(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    data, folder = shared_data / "opencsp", tmp_path_factory.mktemp("dots") / "in"
    names = ("camera_sofast.h5", "spatial_orientation.h5", "Facet_NSTTF.json")
    files = [data / "fixed" / "measurement_facet.h5", data / "fixed" / "fixed_pattern_dot_locations.h5"]
    import_opencsp([*files, *(data / "common" / name for name in names)], folder, OpencspOptions(focal_length_m=150.0))
    return folder


@pytest.fixture(scope="module")
def result(folder: Path) -> Result:
    return run(load_dots(folder))


def test_origin_is_found_unaided(shared_data: Path, result: Result) -> None:
    """The dot nearest to the publisher's origin is dot (0, 0); the light hides it, its neighbours tell."""
    with h5py.File(shared_data / "opencsp" / "fixed" / "measurement_facet.h5") as file:
        origin = file["MeasurementSofastFixed/origin"][()].ravel()
    grid = result.evaluation.screen_map.grid
    first = result.setup.screen.first
    place = grid.pixels_px(np.array([first[1]]), np.array([-first[0]]))[0]
    row, column = np.nonzero(np.isfinite(grid.places_px[..., 0]))
    nearest = np.argmin(np.linalg.norm(grid.places_px[row, column] - origin, axis=1))
    assert (row[nearest], column[nearest]) == (first[1], -first[0])
    assert np.linalg.norm(place - origin) < 0.5 * grid.spacing_px


def test_slopes_are_the_publishers_with_his_pose(shared_data: Path, folder: Path, result: Result) -> None:
    points, slopes = _published(shared_data / "opencsp")
    ours, _, pixels = _measured(result)
    distance, index = cKDTree(points[:, :2]).query(ours)
    shift = np.median(points[index[distance < 0.008], :2] - ours[distance < 0.008], axis=0)
    distance, index = cKDTree(points[:, :2]).query(ours + shift)
    same = distance < 0.008
    assert np.count_nonzero(same) > 0.99 * len(points)
    # Where he has the mirror follows from his points and where the photo shows them.
    camera = result.setup.camera
    rays = camera.cast_rays(pixels[same])
    known, seen = (np.ascontiguousarray(one) for one in (points[index[same]], rays[:, :2] / rays[:, 2:]))
    _, turn, place = cv2.solvePnP(known, seen, np.eye(3), None)
    pose = RigidTransform.from_rotation_vector(turn.ravel(), place.ravel())
    measurement = load_dots(folder)
    content = measurement.model.model_dump(mode="json", exclude_unset=True)
    content["mirror"]["pose"] = {
        "rotation_vector_rad": pose.rotation_vector_rad.tolist(),
        "translation_m": pose.translation_m.tolist(),
    }
    other = folder.parent / "posed"
    other.mkdir()
    for name in ("photo.png", "dots.csv"):
        (other / name).write_bytes((folder / name).read_bytes())
    write_measurement(other, content, comment="With the publisher's pose.")
    found, found_slopes, _ = _measured(run(load_dots(other)))
    distance, index = cKDTree(points[:, :2]).query(found)
    same = distance < 1e-3
    # Beside these: dots that an edge cuts, whose middle he has from what is left of them, and one under the light. Two
    # of them have 0.49 of the usual contrast, where half is asked of a cut dot.
    assert np.count_nonzero(same) >= 3759
    apart = found_slopes[same] - slopes[index[same]]
    apart -= apart.mean(axis=0)
    assert (np.sqrt(np.mean(apart**2, axis=0)) < 0.02e-3).all()


def test_the_set_up_contradicts_itself_and_is_named(result: Result) -> None:
    """The published orientation of camera and screen is not that of this photo: no surface has these slopes."""
    codes = {doubt.code for doubt in result.doubts}
    assert codes & {"slopes_of_no_surface", "setup_contradicts_slopes"}
    assert codes & {"reflection_contradicts_outline", "slopes_of_no_surface"}
