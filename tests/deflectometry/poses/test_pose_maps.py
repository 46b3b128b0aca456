"""One map of several poses: what the poses share does not average down, what each has for itself does."""

import numpy as np
import pytest

from deflectometry.poses.adjustment import adjust_poses
from deflectometry.poses.pose_maps import PoseMaps, combine_maps, keep_map, slopes_of_poses
from deflectometry.setup.setup_steps import PLACE_IN_PATTERN
from deflectometry.shape.common_modes import FACET_PLACE, MIRROR_POSE
from heliogauge.geometry.surfaces import Facet, paraboloid
from heliogauge.slopes.map import CommonModes, SlopeMap

FACET = Facet("one", 0.3 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]), paraboloid(30.0))
NODES = np.linspace(-0.29, 0.29, 30)
NOISE = 2e-5
SOURCES = (MIRROR_POSE, "camera", FACET_PLACE, FACET_PLACE, FACET_PLACE, PLACE_IN_PATTERN)


def _modes(rng: np.random.Generator) -> np.ndarray:
    """Tilts and gradients of 1e-4; the sixth source and the two other directions of the place do nothing."""
    modes = np.zeros((6, 2, 10))
    modes[:3, :, :3] = 1e-4 * rng.normal(size=(3, 2, 3))
    return modes


def _map(error: np.ndarray, modes: np.ndarray) -> SlopeMap:
    nothing, noise = np.zeros((30, 30)), np.full((30, 30), NOISE)
    seen = np.ones((30, 30), dtype=np.bool_)
    return SlopeMap(
        x_m=NODES,
        y_m=NODES,
        slope_x=error[0],
        slope_y=error[1],
        design_slope_x=nothing,
        design_slope_y=nothing,
        sigma_random_x=noise,
        sigma_random_y=noise,
        noise_correlation=1.0,
        common=CommonModes(SOURCES, modes, np.zeros(2), 0.3),
        height_m=nothing,
        flags=np.zeros((30, 30), dtype=np.uint32),
        aperture=seen,
        design="flat",
        frame="facet",
        removed="nothing",
    )


@pytest.mark.parametrize("n_poses", [2, 6])
def test_the_place_of_a_facet_is_off_alike_in_all_poses(n_poses: int) -> None:
    """Mean tilt and gradients of the joint map against the modes that it states, over 200 drawn sets."""
    rng = np.random.default_rng(n_poses)
    # What a place does to the slopes is nearly the same from wherever it is looked at: no pose tells it from the shape.
    place, squares, sigmas = _modes(rng)[2], [], []
    for _ in range(200):
        amount, camera = rng.standard_normal(2)
        poses, templates = [], {}
        for _ in range(n_poses):
            modes = _modes(rng)
            modes[2] = place
            coefficients = -(modes[0] * rng.standard_normal() + modes[1] * camera + modes[2] * amount)
            error = next(CommonModes(("",), coefficients[None], np.zeros(2), 0.3).on_grid(NODES, NODES))
            one = _map(error + NOISE * rng.standard_normal((2, 30, 30)), modes)
            templates.setdefault("one", one)
            poses.append(PoseMaps({"one": keep_map(one)}, np.zeros(1)))
        slopes = slopes_of_poses(poses, templates, [FACET], aligned=False)
        joint = combine_maps(poses, slopes, adjust_poses(slopes), templates, [FACET]).maps["one"]
        found = np.stack([joint.slope_error_x, joint.slope_error_y]).reshape(2, -1).mean(axis=1)
        modes = np.array([np.reshape(one, (2, -1)).mean(axis=1) for one in joint.common.on_grid(NODES, NODES)])
        covariance = modes.T @ modes + NOISE**2 / 900 / n_poses * np.eye(2)
        squares.append(found @ np.linalg.solve(covariance, found) / 2)
        sigmas.append(np.sqrt(np.trace(covariance)))
    # 400 numbers, of which the place is one of each pair: 1 +- 0.1.
    assert np.mean(squares) == pytest.approx(1.0, abs=0.25)
    alone = np.linalg.norm(place[:, :1])
    assert np.median(sigmas) > 0.9 * alone
