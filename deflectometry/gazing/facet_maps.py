"""The slope map of each facet from its nodes, with what all nodes have in common."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.gazing.camera_gains import Gains, d_light_d_place, light_of_profile, slope_design
from deflectometry.gazing.mirror_points import FacetGrid
from deflectometry.gazing.node_slopes import Brightness, NodeSlopes, d_expected_d_deviation, deviations, expected
from deflectometry.gazing.sun_profile import SunProfile
from deflectometry.setup.setup_steps import principal_steps
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.slopes.integration import integrate_slopes
from heliogauge.slopes.map import CommonModes, SlopeMap, monomials
from heliogauge.validate import BoolArray, FlagArray, FloatArray

#: Degree of the polynomials of common modes over one facet.
_DEGREE = 3
#: Source of common modes: the sun's profile, its scale and its noise.
PROFILE = "sun profile"
#: Share of the variance by the profile's noise that its principal combinations keep.
_KEPT = 0.9999
#: Light below so many standard deviations is none.
_LIT_SIGMAS = 4.0
#: A smaller share of the mirror without slopes is its rims.
_WORTH_SAYING = 0.005
#: Chi-square that chance exceeds once in a million nodes.
_CHANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class GazingSigmas:
    """Standard deviations of what is known of the set-up.

    eyes_m (c,): Of each coordinate of each camera's place.
    mirror_m: Of the mirror's place across the sight, against a frame that does not turn with it.
    distance_m: Of the mirror's place along z, or along the sight in a frame that turns with it.
    sun_rad: Of the sun's direction, each way.
    sun_scale: Of the scale of the sun's profile.
    """

    eyes_m: FloatArray
    mirror_m: float = 0.0
    distance_m: float = 0.0
    sun_rad: float = 0.0
    sun_scale: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SolvedFacet:
    """The nodes of one facet and their slopes.

    nodes (ny, nx): Which nodes of the grid they are.
    saturated (ny, nx): Nodes that saturated pixels took from the solution.
    """

    grid: FacetGrid
    nodes: BoolArray
    saturated: BoolArray
    seen: Brightness
    found: NodeSlopes


@dataclass(frozen=True, slots=True, eq=False)
class _Effects:
    """What one sigma of each source does to the slopes of one facet, as polynomials.

    sources: Of the first coefficients.
    stated (k, 2, t), profile (m, 2, t): Coefficients, of the sources and of each step of the profile.
    """

    sources: tuple[str, ...]
    stated: FloatArray
    profile: FloatArray
    center_m: FloatArray
    scale_m: float


def common_modes(facets: Sequence[SolvedFacet], gains: Gains, sigmas: GazingSigmas) -> list[CommonModes]:
    """Return what gains, places, sun and profile that are one sigma off do to the slopes of each facet.

    The steps of the profile are joined to the few combinations that matter.
    """
    effects = [_effects(one, gains.profile, gains, sigmas) for one in facets]
    parts = [one.profile.reshape(len(one.profile), -1) for one in effects]
    _, size, principal = np.linalg.svd(np.concatenate(parts, axis=1), full_matrices=False)
    squares = np.cumsum(size**2)
    count = int(np.searchsorted(squares, _KEPT * squares[-1])) + 1 if size.any() else 0
    joined = np.split(size[:count, None] * principal[:count], np.cumsum([one.shape[1] for one in parts])[:-1], axis=1)
    return [
        CommonModes(
            one.sources + (PROFILE,) * count,
            np.concatenate([one.stated, own.reshape(count, 2, -1)]),
            one.center_m,
            one.scale_m,
        )
        for one, own in zip(effects, joined, strict=True)
    ]


def _effects(facet: SolvedFacet, profile: SunProfile, gains: Gains, sigmas: GazingSigmas) -> _Effects:
    seen, found = facet.seen, facet.found
    outline = facet.grid.facet.outline_m
    center, scale = outline.mean(axis=0), 0.5 * float(np.ptp(outline, axis=0).max())
    usable = np.flatnonzero(np.isfinite(found.slopes).all(axis=1) & _is_lit(seen))
    if usable.size < 40:
        usable = np.flatnonzero(np.isfinite(found.slopes).all(axis=1))
    few = usable[np.linspace(0, usable.size - 1, min(usable.size, 400)).astype(np.intp)]
    some = seen.chosen(few)
    solved = NodeSlopes(found.slopes[few], found.covariance[few], found.misfit[few])
    weight = np.nan_to_num(1.0 / some.sigma**2).T
    design = slope_design(some, solved.slopes, profile, gains.factors)
    # Change of the slopes for a change of each camera's light: the covariance also knows what flat profiles leave.
    gain_of_light = np.einsum("nij,ncj,nc->nic", solved.covariance, design, weight)
    moved = list(_moved(some, solved.slopes, profile, gains, sigmas))
    of_profile = _moved_by_profile(some, solved.slopes, profile, gains)
    light = np.concatenate([np.reshape([one for _, one in moved], (-1, *some.value.shape)), of_profile])
    effects = np.einsum("nic,kcn->kin", gain_of_light, light)
    at = (np.stack([some.x_m, some.y_m]) - center[:, None]) / scale
    terms = monomials(at[0], at[1], _DEGREE if few.size >= 40 else 0)
    # A node that the profile leaves uncertain answers to everything by much: it counts with its own variance.
    trust = 1.0 / np.sqrt(np.trace(solved.covariance, axis1=1, axis2=2))
    stacked = effects.reshape(-1, few.size) * trust
    found_terms = np.linalg.lstsq((terms * trust).T, stacked.T, rcond=None)[0].T
    coefficients = found_terms.reshape(len(light), 2, terms.shape[0])
    return _Effects(
        tuple(source for source, _ in moved), coefficients[: len(moved)], coefficients[len(moved) :], center, scale
    )


def _moved_by_profile(seen: Brightness, slopes: FloatArray, profile: SunProfile, gains: Gains) -> FloatArray:
    """Return what the light lacks of the model for each step of the profile, shape (k, c, n).

    The gains and places that follow the wrong profile are in it.
    """
    count, factors = len(gains.logarithm), gains.factors
    own = light_of_profile(seen, slopes, profile, factors)
    light = factors[:, None] * expected(seen, slopes, profile)
    by_place = d_light_d_place(seen, slopes, profile, factors)
    change = gains.by_profile.reshape(3, count, -1)
    own = own + light[..., None] * change[0][:, None]
    own = own + np.einsum("nca,ack->cnk", by_place, change[1:])
    return np.asarray(-np.moveaxis(own, 2, 0))


def _moved(
    seen: Brightness, slopes: FloatArray, profile: SunProfile, gains: Gains, sigmas: GazingSigmas
) -> Iterator[tuple[str, FloatArray]]:
    """Yield each source, and what one sigma of it does to the light of each camera (c, n)."""
    light = gains.factors[:, None] * expected(seen, slopes, profile)
    steep = d_expected_d_deviation(seen, slopes, profile) * gains.factors[:, None, None]
    off = deviations(seen, slopes)

    def through(moved: Brightness) -> FloatArray:
        change = (deviations(moved, slopes) - off).mean(axis=2)
        return np.asarray((steep * change).sum(axis=2))

    count = len(gains.logarithm)
    for step in principal_steps(gains.covariance):
        shift = step[count:].reshape(2, count).T
        yield "brightness levels and places", step[:count, None] * light + through(seen.moved(shift))
    along = np.array([0.0, 0.0, 1.0])
    for camera, sigma in enumerate(sigmas.eyes_m):
        eyes = seen.eyes_m.copy()
        eyes[camera] += sigma * along
        yield "distance", through(replace(seen, eyes_m=eyes))
    if sigmas.distance_m > 0:
        # The mirror's own place moves all cameras alike; a frame that turns with it feels only what is along the sight.
        sight = (seen.eyes_m.mean(axis=0) - seen.places_m.mean(axis=(0, 1, 2))) if sigmas.mirror_m == 0 else along
        eyes = seen.eyes_m + sigmas.distance_m * sight / np.linalg.norm(sight)
        yield "distance", through(replace(seen, eyes_m=eyes))
    if sigmas.sun_rad > 0:
        across = np.linalg.svd(seen.sun[None])[2][1:]
        for one in across:
            sun = seen.sun + sigmas.sun_rad * one
            # The components across the sun change by the sun's own turn: the basis itself hardly does.
            yield "sun direction", through(replace(seen, sun=sun / np.linalg.norm(sun)))
    if sigmas.sun_scale > 0:
        yield PROFILE, -sigmas.sun_scale * (steep * off.mean(axis=2)).sum(axis=2)


def _is_lit(seen: Brightness) -> BoolArray:
    return np.asarray((seen.value > _LIT_SIGMAS * seen.sigma).any(axis=0))


def facet_map(facet: SolvedFacet, common: CommonModes, largest_sigma_rad: float, frame: str) -> SlopeMap:
    """Put the nodes of one facet on its grid, each that has no slope with its reason.

    largest_sigma_rad: Nodes that are known worse are blind.
    """
    from scipy.stats import chi2

    grid, seen, found = facet.grid, facet.seen, facet.found
    shape = grid.aperture.shape
    sigma = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    freedom = np.maximum(np.count_nonzero(np.isfinite(seen.value), axis=0) - 2, 1)
    reason: FlagArray = np.zeros(seen.x_m.size, dtype=np.uint32)
    lit = _is_lit(seen)
    reason[~lit] = np.uint32(SampleFlag.NOT_SEEN)
    reason[lit & (sigma.max(axis=1) > largest_sigma_rad)] |= np.uint32(SampleFlag.BLIND)
    reason[lit & (found.misfit > chi2.isf(_CHANCE, freedom))] |= np.uint32(SampleFlag.OUTLIER)
    kept = reason == 0
    flags = np.where(grid.aperture, SampleFlag.MIRROR_EDGE, SampleFlag.OUTSIDE_MIRROR).astype(np.uint32)
    flags[facet.saturated & grid.aperture] = np.uint32(SampleFlag.SATURATED)
    flags[facet.nodes] = reason

    def on_grid(values: FloatArray) -> FloatArray:
        whole = np.full(shape, np.nan)
        whole[facet.nodes] = np.where(kept, values, np.nan)
        return whole

    design = grid.facet.design
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    height, own_x, own_y = (np.where(grid.aperture, one, np.nan) for one in design.height_and_gradient(x, y))
    slope_x, slope_y = on_grid(found.slopes[:, 0]), on_grid(found.slopes[:, 1])
    try:
        step = float(grid.x_m[1] - grid.x_m[0])
        height = height + integrate_slopes(slope_x - own_x, slope_y - own_y, (step, step))
    except EstimationError:
        height = np.full(shape, np.nan)
    return SlopeMap(
        x_m=grid.x_m,
        y_m=grid.y_m,
        slope_x=slope_x,
        slope_y=slope_y,
        design_slope_x=own_x,
        design_slope_y=own_y,
        sigma_random_x=on_grid(sigma[:, 0]),
        sigma_random_y=on_grid(sigma[:, 1]),
        noise_correlation=1.0,
        common=common,
        height_m=height,
        flags=flags,
        aperture=grid.aperture,
        design=design.describe(),
        frame=frame,
        removed="nothing",
    )


def misfit_factor(facets: Sequence[SolvedFacet]) -> float:
    """Return by how much brightness scatters more than its sigmas say, at least 1."""
    from scipy.stats import chi2

    ratios = []
    for facet in facets:
        cameras = np.count_nonzero(np.isfinite(facet.seen.value), axis=0)
        lit = (cameras > 2) & _is_lit(facet.seen)
        ratios.append(facet.found.misfit[lit] / chi2.median(cameras[lit] - 2))
    together = np.concatenate(ratios)
    return max(1.0, float(np.sqrt(np.median(together)))) if together.size else 1.0


def blind_zones(maps: Sequence[SlopeMap]) -> Iterator[Doubt]:
    """Yield what share of the mirror is blind, and what has no sun."""
    area = sum(int(np.count_nonzero(one.aperture)) for one in maps)

    def share_of(flag: SampleFlag) -> float:
        return sum(int(np.count_nonzero(one.aperture & ((one.flags & np.uint32(flag)) != 0))) for one in maps) / area

    blind, dark = share_of(SampleFlag.BLIND), share_of(SampleFlag.NOT_SEEN)
    if blind > _WORTH_SAYING:
        yield Doubt(
            "blind_zones",
            f"{100 * blind:.0f} % of the mirror is blind: there the sun looks so even to all cameras that brightness "
            "says too little of the slope; cameras farther apart see it: `heliogauge deflectometry plan` says how far",
            {"blind_share": blind},
        )
    if dark > _WORTH_SAYING:
        yield Doubt(
            "mirror_without_sun",
            f"{100 * dark:.0f} % of the mirror shows no camera the sun; measure it at another time, or with cameras "
            "farther apart",
            {"dark_share": dark},
        )
