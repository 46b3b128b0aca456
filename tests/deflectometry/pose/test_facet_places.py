"""Places of single facets from their outlines: offsets of drawn facets against their covariance, and who is named."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deflectometry.pose.adjust_pose import pose_from_outline
from deflectometry.pose.facet_places import FacetPlaces, OutlinedEnsemble, facet_places, stated_places
from deflectometry.pose.pose_observations import Knowledge
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.geometry.surfaces import Facet, paraboloid
from heliogauge.validate import FloatArray
from tests.deflectometry.drawing import draw_mirror

CAMERA = Camera(300, 330, 840.0, 840.0, 150.0, 165.0)
POSE = RigidTransform.from_rotation_vector([np.pi, 0, 0], [0.05, 0.02, 11.0]).moved([0.1, 0.2, 0.06, 0, 0, 0])
HALF = 0.5 * np.array([0.6, 0.5])
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * HALF


def _ensemble() -> list[Facet]:
    facets = []
    for row in range(6):
        for column in range(4):
            x, y = (column - 1.5) * 0.68, (row - 2.5) * 0.58
            place = RigidTransform.from_rotation_vector([y / 60, -x / 60, 0], [x, y, (x * x + y * y) / 120])
            facets.append(Facet(f"{row}{column}", CORNERS, paraboloid(30.0), place))
    return facets


def _moved(facet: Facet, step_m: FloatArray) -> Facet:
    place = facet.ensemble_from_facet
    return replace(facet, ensemble_from_facet=RigidTransform(place.rotation, place.translation_m + step_m))


def _places(steps_m: FloatArray, stated_m: Sequence[FloatArray | None], seed: int = 1) -> FacetPlaces:
    """Draw facets that are off their places, and find where they are with the places that they should have."""
    facets = _ensemble()
    image = draw_mirror(CAMERA, POSE, [_moved(one, step) for one, step in zip(facets, steps_m, strict=True)])
    image = image + np.random.default_rng(seed).normal(0, 1.0, image.shape)
    found = pose_from_outline(image, CAMERA, facets, Knowledge(sigma_places_m=tuple(stated_m)))
    pose, observations = found.cam_from_mirror, found.observations
    return facet_places(
        OutlinedEnsemble(CAMERA, facets, observations, pose, found.covariance, gives_pose=True), stated_m
    )


def test_offsets_of_displaced_facets_are_no_farther_off_than_their_covariance_says() -> None:
    """24 facets, two seeds; shifts and turns of all facets together are in the pose of the ensemble.

    Drawn sides have no rims, for which the covariance allows: the ratio is small. (Of the edge points alone it is 1.65:
    what is left in the place of a drawn edge is no noise.)
    """
    squares = []
    places = np.array([one.ensemble_from_facet.translation_m for one in _ensemble()])
    together = np.concatenate([np.hstack([-skew(place), np.eye(3)]) for place in places])
    for seed in range(2):
        steps = 0.004 * np.random.default_rng(10 + seed).standard_normal((24, 3))
        found = _places(steps, [np.full(3, 0.004)] * 24, seed)
        errors = np.array([one.offset_m for one in found.places]) - steps
        weights = [np.linalg.inv(np.linalg.cholesky(one.covariance_offset_m2)) for one in found.places]
        whitened = np.concatenate([weight @ error for weight, error in zip(weights, errors, strict=True)])
        pose = np.concatenate([weight @ together[3 * k : 3 * k + 3] for k, weight in enumerate(weights)])
        left = whitened - pose @ np.linalg.lstsq(pose, whitened, rcond=None)[0]
        squares.append(float(left @ left) / (left.size - 6))
        np.testing.assert_allclose(found.places[0].covariance_m2, 0.004**2 * np.eye(3), rtol=1e-9)
    # 0.21; half and double of it would be other covariances.
    assert 0.1 < np.sqrt(np.mean(squares)) < 0.42


def test_a_facet_off_its_place_is_named_and_its_distance_counts() -> None:
    steps = np.zeros((24, 3))
    steps[9] = [0.01, 0.0, 0.0]
    found = _places(steps, [np.full(3, 0.001)] * 24)
    (doubt,) = found.doubts
    assert doubt.code == "facet_off_its_place"
    assert doubt.numbers["facets_count"] == 1
    assert "21 by" in doubt.text
    assert abs(found.places[9].offset_m[0] - 0.01) < 3 * np.sqrt(found.places[9].covariance_offset_m2[0, 0])
    assert found.places[9].covariance_m2[0, 0] > 0.007**2
    assert found.places[8].covariance_m2[0, 0] < 0.0011**2


def test_places_that_nobody_states_are_known_as_outlines_know_them() -> None:
    found = _places(np.zeros((24, 3)), [None] * 24)
    (note,) = found.doubts
    assert note.code == "facet_places_from_outlines"
    for one in found.places:
        np.testing.assert_array_equal(one.covariance_m2, one.covariance_offset_m2)
        across, along = np.sqrt(np.diag(one.covariance_m2))[[0, 2]]
        # Sides of 0.04 px, as rims leave them: 0.03 px of 13 mm across, with the turn 4 mm; more along the sight.
        assert 1e-3 < across < 5e-3
        assert 8e-3 < along < 2e-2
    unseen = stated_places(_ensemble(), [None] * 23 + [np.full(3, 0.001)])
    np.testing.assert_allclose(unseen.places[0].covariance_m2, 0.3**2 * np.eye(3))
    np.testing.assert_allclose(unseen.places[23].covariance_m2, 0.001**2 * np.eye(3))
