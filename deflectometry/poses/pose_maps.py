"""The maps of single poses: what is kept of each, what the adjustment takes from them, and one map of them all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.poses.adjustment import JointSolution, PoseSlopes
from deflectometry.setup.setup_steps import PLACE_IN_PATTERN, principal_steps
from deflectometry.shape.common_modes import FACET_PLACE, MIRROR_POSE
from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.integration import integrate_slopes
from heliogauge.slopes.map import CommonModes, SlopeMap, monomials
from heliogauge.validate import BoolArray, FlagArray, Float32Array, FloatArray

#: Sources whose errors each pose has for itself; all others, of camera and screen and of the places of facets in the
#: mirror, are the same in all poses.
_OWN_SOURCES = (MIRROR_POSE, PLACE_IN_PATTERN, "fringe periods")
#: Turns of the aligned mirror between poses: the tilt of a rough surface is sure to far less.
_TURN_RAD = 1e-3
#: Nodes worked on at a time.
_BLOCK = 16384
#: Fewer nodes that all poses measured do not hold polynomials of degree 3 ten times over.
_FEWEST_NODES = 200
#: The source of what is left, in the map of all poses.
SOURCE = "setup and poses"


@dataclass(frozen=True, slots=True, eq=False)
class KeptMap:
    """What is kept of the map of one facet in one pose.

    error, sigma (2, ny, nx): Slope errors and their random sigma; NaN where not measured [rad].
    flags (ny, nx): As in the map.
    common: Modes of the pose.
    noise_correlation: As in the map.
    """

    error: Float32Array
    sigma: Float32Array
    flags: FlagArray
    common: CommonModes
    noise_correlation: float

    @property
    def measured(self) -> BoolArray:
        """Nodes with a value, shape (ny, nx)."""
        return np.asarray(np.isfinite(self.error[0]))


def keep_map(slope_map: SlopeMap) -> KeptMap:
    """Keep what the adjustment needs of a map: a fifth of its memory."""
    valid = slope_map.valid
    error = np.where(valid, np.stack([slope_map.slope_error_x, slope_map.slope_error_y]), np.nan)
    sigma = np.where(valid, np.stack([slope_map.sigma_random_x, slope_map.sigma_random_y]), np.nan)
    return KeptMap(
        error.astype(np.float32),
        sigma.astype(np.float32),
        slope_map.flags,
        slope_map.common,
        slope_map.noise_correlation,
    )


@dataclass(frozen=True, slots=True, eq=False)
class PoseMaps:
    """The maps of one pose, and the amounts of the common errors with which they were measured.

    maps: Of each measured facet by its name.
    measured_at (k,): Amounts of those of camera and screen, in stated sigmas.
    """

    maps: dict[str, KeptMap]
    measured_at: FloatArray


def slopes_of_poses(
    poses: Sequence[PoseMaps], templates: Mapping[str, SlopeMap], facets: Sequence[Facet], *, aligned: bool
) -> list[PoseSlopes]:
    """Fit the maps of all poses by polynomials over the nodes that every pose measured.

    templates: A map of each facet that every pose measured: grid and design.
    facets: The mirror.
    aligned: The slopes refer to their own mean normal: poses may be turned against each other.
    EstimationError: The poses have too little of the mirror in common.
    """
    places = {facet.name: facet for facet in facets}
    parts: list[list[_FacetFit]] = [[] for _ in poses]
    for name, template in templates.items():
        measured = np.logical_and.reduce([one.maps[name].measured for one in poses])
        count = int(np.count_nonzero(measured))
        if count < _FEWEST_NODES:
            raise EstimationError(
                f"facet {name}: only {count} nodes are measured in every pose, {_FEWEST_NODES} are needed; leave out "
                "the pose in which most of it is missing"
            )
        for fits, one in zip(parts, poses, strict=True):
            fits.append(_fit_facet(one.maps[name], template, places[name], measured, aligned=aligned))
    return [_joined(fits, one.measured_at, aligned=aligned) for fits, one in zip(parts, poses, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class _FacetFit:
    """Coefficients (20,) of one facet, their covariance, and the changes (20, k) and (20, m) by errors."""

    slopes: FloatArray
    covariance: FloatArray
    common: FloatArray
    own: FloatArray


def _fit_facet(kept: KeptMap, template: SlopeMap, facet: Facet, measured: BoolArray, *, aligned: bool) -> _FacetFit:
    """Fit one facet, by equal weights: what no polynomial holds is left out alike in all poses."""
    modes = kept.common
    rows, columns = np.nonzero(measured)
    terms = modes.coefficients.shape[2]
    n_turns = 2 if aligned else 0
    normal, noise = np.zeros((terms, terms)), np.zeros((2, terms, terms))
    right = np.zeros((1 + n_turns, 2, terms))
    for start in range(0, rows.size, _BLOCK):
        row, column = rows[start : start + _BLOCK], columns[start : start + _BLOCK]
        x_m, y_m = template.x_m[column], template.y_m[row]
        basis = monomials(
            (x_m - modes.center_m[0]) / modes.scale_m, (y_m - modes.center_m[1]) / modes.scale_m, modes.degree
        )
        normal += basis @ basis.T
        values = [kept.error[:, row, column].astype(np.float64)]
        slopes = np.stack([template.design_slope_x[row, column], template.design_slope_y[row, column]])
        values += [_turned(slopes, facet, axis) for axis in range(n_turns)]
        right += np.stack(values) @ basis.T
        for axis in (0, 1):
            noise[axis] += (basis * kept.sigma[axis, row, column].astype(np.float64) ** 2) @ basis.T
    solver = np.linalg.inv(normal)
    fitted = right @ solver
    covariance = np.zeros((2 * terms, 2 * terms))
    for axis in (0, 1):
        part = slice(axis * terms, (axis + 1) * terms)
        covariance[part, part] = kept.noise_correlation * solver @ noise[axis] @ solver
    is_own, is_place = (
        np.array([source in group for source in modes.sources], dtype=bool) for group in (_OWN_SOURCES, (FACET_PLACE,))
    )
    changes = modes.coefficients.reshape(len(modes.sources), -1).T
    turns = fitted[1:].reshape(n_turns, 2 * terms).T
    return _FacetFit(
        fitted[0].ravel(),
        covariance,
        np.concatenate([changes[:, ~is_own & ~is_place], changes[:, is_place]], axis=1),
        np.concatenate([changes[:, is_own], turns], axis=1),
    )


def _turned(slopes: FloatArray, facet: Facet, axis: int) -> FloatArray:
    """Return the change of slopes (2, n) for a small turn of the whole mirror about its x or y axis."""
    turn_x, turn_y, turn_z = _TURN_RAD * facet.ensemble_from_facet.rotation[axis]
    slope_x, slope_y = slopes
    return np.stack(
        [
            -turn_y - turn_z * slope_y + turn_x * slope_x * slope_y - turn_y * slope_x**2,
            turn_x + turn_z * slope_x + turn_x * slope_y**2 - turn_y * slope_x * slope_y,
        ]
    )


def _joined(fits: Sequence[_FacetFit], measured_at: FloatArray, *, aligned: bool) -> PoseSlopes:
    sizes = np.cumsum([0, *(one.slopes.size for one in fits)])
    covariance = np.zeros((sizes[-1], sizes[-1]))
    for low, high, one in zip(sizes[:-1], sizes[1:], fits, strict=True):
        covariance[low:high, low:high] = one.covariance
    common = np.concatenate([one.common for one in fits])
    return PoseSlopes(
        np.concatenate([one.slopes for one in fits]),
        covariance,
        common,
        np.concatenate([one.own for one in fits]),
        # Facets are measured where they are stated to be.
        np.pad(measured_at, (0, common.shape[1] - measured_at.size)),
        free_turns=2 if aligned else 0,
    )


@dataclass(frozen=True, slots=True, eq=False)
class JointMaps:
    """One map of each facet from all poses.

    maps: By the name of the facet.
    correction_rad: RMS of what the adjustment still changes in the poses' slopes: how far the linear step reached.
    sigma_common_rad: RMS of the common share of the sigma.
    """

    maps: dict[str, SlopeMap]
    correction_rad: float
    sigma_common_rad: float


def combine_maps(
    poses: Sequence[PoseMaps],
    slopes: Sequence[PoseSlopes],
    solution: JointSolution,
    templates: Mapping[str, SlopeMap],
    facets: Sequence[Facet],
) -> JointMaps:
    """Correct the maps of all poses by what the adjustment found, and take their weighted mean.

    slopes: From `slopes_of_poses`.
    Returns: Maps whose common modes are what the adjustment leaves open.

    Each pose has one weight in a facet, from the mean variance of its nodes: a node that some poses did not measure
    has the mean of the others.
    """
    corrections = [
        one.common @ (solution.common - one.measured_at) + one.own @ own
        for one, own in zip(slopes, solution.own, strict=True)
    ]
    sizes = np.cumsum([0, *(2 * templates[name].common.coefficients.shape[2] for name in templates)])
    weights = {
        name: np.array([1.0 / np.nanmean(one.maps[name].sigma.astype(np.float64) ** 2) for one in poses])
        for name in templates
    }
    share = np.concatenate(
        [
            np.repeat((weights[name] / weights[name].sum())[None], high - low, axis=0)
            for name, low, high in zip(templates, sizes[:-1], sizes[1:], strict=True)
        ]
    )
    carry = np.concatenate(
        [
            sum(
                (share[:, [number]] * one.common for number, one in enumerate(slopes)), np.zeros(slopes[0].common.shape)
            ),
            *(share[:, [number]] * one.own for number, one in enumerate(slopes)),
        ],
        axis=1,
    )
    left = principal_steps(carry @ solution.covariance @ carry.T)
    maps, squares = {}, []
    heights = {facet.name: facet for facet in facets}
    for (name, template), low, high in zip(templates.items(), sizes[:-1], sizes[1:], strict=True):
        common = replace(
            template.common,
            sources=(SOURCE,) * len(left),
            coefficients=left[:, low:high].reshape(len(left), 2, -1),
        )
        by_pose = [one[low:high].reshape(1, 2, -1) for one in corrections]
        shifted = [replace(template.common, sources=("",), coefficients=one) for one in by_pose]
        kept = [one.maps[name] for one in poses]
        maps[name] = _mean_map(kept, shifted, weights[name], template, heights[name], solution.noise_factor, common)
        valid = maps[name].valid
        sigma = float(np.sqrt(common.variance_on_grid(template.x_m, template.y_m)[:, valid].mean()))
        moved = [next(one.on_grid(template.x_m, template.y_m))[:, valid] for one in shifted]
        squares.append((float(np.mean(np.square(moved))), sigma**2))
    correction, sigma = np.sqrt(np.mean(squares, axis=0)).tolist()
    return JointMaps(maps, correction, sigma)


def _mean_map(
    kept: Sequence[KeptMap],
    corrections: Sequence[CommonModes],
    weights: FloatArray,
    template: SlopeMap,
    facet: Facet,
    noise_factor: float,
    common: CommonModes,
) -> SlopeMap:
    total, error, variance = np.zeros(template.shape), np.zeros((2, *template.shape)), np.zeros((2, *template.shape))
    flags = np.zeros(template.shape, dtype=np.uint32)
    for one, change, weight in zip(kept, corrections, weights, strict=True):
        measured = one.measured
        corrected = one.error + next(change.on_grid(template.x_m, template.y_m))
        total += np.where(measured, weight, 0.0)
        error += np.where(measured, weight * corrected, 0.0)
        variance += np.where(measured, (weight * one.sigma.astype(np.float64)) ** 2, 0.0)
        flags |= one.flags
    known = total > 0
    flags[known] &= np.bitwise_and.reduce([np.where(one.measured, one.flags, np.uint32(0xFFFFFFFF)) for one in kept])[
        known
    ]
    flags[~known & template.aperture & (flags == 0)] = np.uint32(SampleFlag.NOT_SEEN)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.where(known, error / total, np.nan)
        sigma = np.where(known, noise_factor * np.sqrt(variance) / total, np.nan)
    design = np.stack([template.design_slope_x, template.design_slope_y])
    step_m = float(template.x_m[1] - template.x_m[0])
    height = facet.design.height(*np.meshgrid(template.x_m, template.y_m))
    try:
        height = height + integrate_slopes(error[0], error[1], (step_m, step_m))
        # The pose's frame stands on the surface at the reference point: keep the height that the first pose has there.
        height += np.nanmedian(template.height_m - height)
    except EstimationError:
        height = np.full(template.shape, np.nan)
    return replace(
        template,
        slope_x=design[0] + error[0],
        slope_y=design[1] + error[1],
        sigma_random_x=sigma[0],
        sigma_random_y=sigma[1],
        noise_correlation=float(weights @ [one.noise_correlation for one in kept] / weights.sum()),
        common=common,
        height_m=height,
        flags=flags,
    )
