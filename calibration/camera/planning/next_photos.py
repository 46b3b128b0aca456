"""The photos that reduce the sigma of a calibration most, one after the other, and what it will be with them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.camera.adjustment.another_photo import gains_of_photos, predict_photo
from calibration.camera.adjustment.mixed_adjustment import MixedAdjustment, Sizes, adjust_mixed
from calibration.camera.adjustment.variance_components import Components
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.files.result import Result
from calibration.camera.judgement.projection_sigma import map_nodes, sigma_map, without_rotation
from calibration.camera.planning.candidate_views import Lengths, candidate_views
from calibration.camera.start_values.board_network import BoardNetwork
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleState
from photogrammetry.bundle import state as states

#: Views are compared by so many of the board's points; their noise is smaller by as much as they are fewer.
_COMPARED_POINTS = 60
#: Views that are examined together.
_EXAMINED_AT_ONCE = 32
#: The points of photos that are not yet taken are drawn as the adjustment predicts them, so many times, always alike:
#: what they will say of the effects' sizes is a matter of chance, and the sigma of one draw is off by a third.
_DRAWS, _SEED = 4, 13


@dataclass(frozen=True, eq=False)
class Expectation:
    """A calibration with photos that are not yet taken.

    draws: The adjustment with each draw of their points; the only one where there are no such photos.
    """

    draws: tuple[MixedAdjustment, ...]

    @cached_property
    def covariance_intrinsics(self) -> FloatArray:
        """Covariance of the free intrinsics that is expected, shape (c, c)."""
        return np.asarray(np.mean([one.covariance_intrinsics for one in self.draws], axis=0))

    @cached_property
    def camera(self) -> Camera:
        """Today's camera with the covariance that is expected."""
        covariance = np.mean([one.camera.covariance for one in self.draws], axis=0)
        return self.draws[0].state.cameras[0].with_covariance(covariance)

    @cached_property
    def cautious(self) -> MixedAdjustment:
        """An adjustment whose effects are as large as they may well be: its covariance is nearly the expected one."""
        first = self.draws[0]
        squares = np.mean([one.likely_sizes.components.effects**2 for one in self.draws], axis=0)
        components = replace(first.sizes.components, effects=np.sqrt(squares))
        posterior = first.posterior.model.solve(components)
        return replace(first, posterior=posterior, sizes=Sizes(first.sizes.names, components))

    def with_photo(self, pose: RigidTransform, name: str, rngs: Sequence[np.random.Generator]) -> "Expectation":
        """Return what is expected with one photo more.

        pose: Its ``cam_from_board``.
        rngs: Draw its points, one for each draw.
        """
        draws = self.draws if len(self.draws) == len(rngs) else self.draws * len(rngs)
        return Expectation(tuple(with_photo(one, pose, name, rng) for one, rng in zip(draws, rngs, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class NextPhoto:
    """A photo to take.

    name: Name in the plan.
    cam_from_board: From where.
    expected: The calibration with it and those before it.
    """

    name: str
    cam_from_board: RigidTransform
    expected: Expectation


def adjusted_again(result: Result) -> MixedAdjustment:
    """Return the adjustment that gave a result, with the sizes of the random effects that it found.

    result: A calibration, also one that was read from its folder.
    InputError: The files of the result do not belong together.
    EstimationError: The image points do not hold the calibration.
    """
    shape, common = result.shape, result.common
    if any((one.index < 0).any() for one in result.photos):
        raise InputError("calibration: image_points.csv has points that points.csv does not have")
    if not all(0 < one.noise_ratio < np.inf for one in result.photos):
        raise InputError("calibration: photos.csv: noise_ratio is missing; calibrate again")
    points = tuple(
        BoardPoints(one.name, one.index[one.used], one.pixels_px[one.used], one.covariance_px2[one.used])
        for one in result.photos
    )
    free = tuple(one.name for one in result.intrinsics)
    poses = tuple(one.cam_from_board for one in result.photos)
    network = BoardNetwork(shape.board, points, free, result.camera, poses, places_known=shape.has_drawing)
    place = np.full(len(shape.board.names), -1, dtype=np.intp)
    place[shape.seen] = np.arange(shape.seen.size)
    start = BundleState.from_poses([result.camera], poses, shape.points_m[place[network.seen]])
    noise = np.array([one.noise_ratio for one in result.photos])
    sizes = Sizes(common.names, Components(common.effects, common.point, noise))
    held = not bool(shape.prior_sigma_m.any())
    return adjust_mixed(network, network.observations(), start, refine_board=not held, sizes=sizes, settled=True)


def importance(camera: Camera, free: tuple[str, ...], covariance: FloatArray, names: Sequence[str]) -> FloatArray:
    """Return Q so that the trace of Q C is what shall become small, C being the covariance of the free intrinsics.

    covariance (c, c): Theirs today.
    names: Intrinsics; without any, lines of sight all over the image, the best rotation taken out.
    Returns (c, c): For names, the mean of their variances over today's; otherwise that of lines of sight [rad^2].
    """
    if names:
        chosen = np.array([float(name in names) for name in _ordered(free)])
        return np.diag(chosen / chosen.sum() / np.diag(covariance))
    rays, _, d_parameters = camera.cast_rays_with_jacobians(map_nodes(camera).pixels_px.reshape(-1, 2))
    columns = [k for k, name in enumerate(states.INTRINSIC_NAMES) if name in free]
    moves = d_parameters @ states.d_parameters_d_intrinsics(camera)[:, columns]
    good = np.isfinite(moves).all(axis=(1, 2))
    rest = without_rotation(rays[good], moves[good])[0]
    return np.asarray(np.einsum("nia,nib->ab", rest, rest) / len(rest))


def _ordered(free: tuple[str, ...]) -> list[str]:
    return [name for name in states.INTRINSIC_NAMES if name in free]


def choose_photos(
    today: Expectation,
    lengths: Lengths,
    names: Sequence[str],
    count: int,
    *,
    wanted_rad: float = 0.0,
    tell: Callable[[], None] | None = None,
) -> list[NextPhoto]:
    """Choose photos one after the other: each time the view that leaves least of what shall become small.

    today: The calibration so far.
    names: Intrinsics whose sigmas shall become small; none: lines of sight.
    count: How many photos at most.
    wanted_rad: Sigma of lines of sight, best rotation taken out, that ends the search [rad].
    tell: Called after each photo.
    EstimationError: No view of the whole board can be taken.

    What a view leaves is predicted from the normal equations with all random effects as large as they may well be. A
    view that adds less than another one still does so after further photos, as a rule: views are examined again in the
    order of what they added before (Minoux 1978), until the best of those examined adds more than the others ever did.
    """
    camera = today.camera
    views = list(candidate_views(camera, lengths))
    if not views:
        raise EstimationError(
            f"plan: no view shows the whole board from {lengths.nearest_m:.3g} to {lengths.farthest_m:.3g} away "
            "(unit of photos.csv); give other distances"
        )
    weight = importance(camera, today.draws[0].network.free, today.covariance_intrinsics, names)
    chosen: list[NextPhoto] = []
    gains = np.full(len(views), np.inf)
    rngs = [np.random.default_rng([_SEED, draw]) for draw in range(_DRAWS)]
    while len(chosen) < count:
        now = chosen[-1].expected if chosen else today
        template = _board_points(now.cautious, "view")
        examined = np.zeros(len(views), dtype=np.bool_)
        order = np.argsort(-gains, kind="stable")
        for start in range(0, order.size, _EXAMINED_AT_ONCE):
            some = order[start : start + _EXAMINED_AT_ONCE]
            if examined.any() and gains[examined].max() >= gains[some[0]]:
                break
            found = gains_of_photos(now.cautious, template, [views[view] for view in some.tolist()])
            gains[some] = (weight * found).sum(axis=(1, 2))
            examined[some] = True
        best = int(np.argmax(np.where(examined, gains, -np.inf)))
        name = f"next_{len(chosen) + 1:02d}"
        chosen.append(NextPhoto(name, views[best], now.with_photo(views[best], name, rngs)))
        if tell is not None:
            tell()
        if wanted_rad and sigma_map(chosen[-1].expected.camera).rms_free_rad <= wanted_rad:
            break
    return chosen


def _board_points(mixed: MixedAdjustment, name: str, most: int = _COMPARED_POINTS) -> BoardPoints:
    """Return points of a photo that is not yet taken, with the noise of those that are, at no places."""
    seen = mixed.network.seen
    chosen = np.sort(np.random.default_rng(_SEED).permutation(seen)[:most])
    usual = np.median(mixed.table.covariance_px2, axis=0) * (chosen.size / seen.size)
    return BoardPoints(name, chosen, np.zeros((chosen.size, 2)), np.tile(usual, (chosen.size, 1, 1)))


def with_photo(mixed: MixedAdjustment, pose: RigidTransform, name: str, rng: np.random.Generator) -> MixedAdjustment:
    """Adjust with one photo more, its points drawn as the adjustment predicts them.

    pose: Its ``cam_from_board``.
    rng: Draws camera, board and the photo's errors as they may be.
    """
    empty = _board_points(mixed, name, mixed.network.seen.size)
    points = replace(empty, pixels_px=predict_photo(mixed, empty, pose).drawn_px(rng))
    network = replace(mixed.network, points=(*mixed.network.points, points), poses=(*mixed.network.poses, pose))
    table, state, sizes = mixed.table, mixed.state, mixed.sizes
    place = np.full(len(network.board.names), -1, dtype=np.intp)
    place[network.seen] = np.arange(network.seen.size)
    more = ImagePoints(
        (*table.photos, name),
        table.targets,
        np.concatenate([table.photo_index, np.full(points.n, len(table.photos))]),
        np.concatenate([table.target_index, place[points.index]]),
        np.concatenate([table.pixels_px, points.pixels_px]),
        np.concatenate([table.covariance_px2, points.covariance_px2]),
    )
    start = replace(
        state,
        rotations=np.concatenate([state.rotations, pose.rotation[None]]),
        translations_m=np.concatenate([state.translations_m, pose.translation_m[None]]),
    )
    noise = np.append(sizes.components.noise, np.median(sizes.components.noise))
    return adjust_mixed(
        network,
        more,
        start,
        refine_board=mixed.refine_board,
        sizes=Sizes(sizes.names, replace(sizes.components, noise=noise)),
        settled=True,
    )
