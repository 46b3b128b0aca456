"""Which stars a facet shows and how it leans: all hypotheses with their odds, then least squares."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Share of points of light that are no star of the catalogue: aircraft, hot pixels, fainter stars.
_STRANGE = 0.1
#: Standard deviation of a star's brightness against the catalogue [magnitude]: colours, zero point.
_MAGNITUDE_SIGMA = 0.8
#: Hypotheses whose leans differ by less than so many standard deviations are the same.
_SAME = 4.0
_ROUNDS = 8
#: Points of light that propose leans: with a tenth of strange ones all of them are strange once in 10^12.
_PROPOSING = 12
#: Points of light farther than this from their star are not it: 1 of 10^7 Gaussian ones [sigma, of two axes].
_TOO_FAR = 5.5


@dataclass(frozen=True, slots=True, eq=False)
class FacetLight:
    """Points of light that one facet shows, of all photos.

    facet: With its design.
    photo (n,): Which photo each is of.
    places_px (n, 2): Where it is in the photo.
    sights (n, 3): Unit directions from the camera, in the facet's frame.
    d_sight_d_px (n, 3, 2): Their derivatives by the image point [1/px].
    eye_m (3,): The camera, in the facet's frame.
    sigma_px (n,): Of each image coordinate. magnitude (n,): Their brightness.
    """

    facet: Facet
    photo: IntArray
    places_px: FloatArray
    sights: FloatArray
    d_sight_d_px: FloatArray
    eye_m: FloatArray
    sigma_px: FloatArray
    magnitude: FloatArray

    def chosen(self, points: IntArray) -> "FacetLight":
        """Return some of the points."""
        return FacetLight(
            self.facet,
            self.photo[points],
            self.places_px[points],
            self.sights[points],
            self.d_sight_d_px[points],
            self.eye_m,
            self.sigma_px[points],
            self.magnitude[points],
        )


@dataclass(frozen=True, slots=True, eq=False)
class SkyOfFacet:
    """Stars of each photo in the facet's frame.

    directions (m, 3) and magnitude (m,), number (m,) of each photo.
    """

    directions: Sequence[FloatArray]
    magnitude: Sequence[FloatArray]
    number: Sequence[IntArray]

    def chosen(self, which: Sequence[IntArray]) -> "SkyOfFacet":
        """Return some stars of each photo."""
        return SkyOfFacet(
            [one[some] for one, some in zip(self.directions, which, strict=True)],
            [one[some] for one, some in zip(self.magnitude, which, strict=True)],
            [one[some] for one, some in zip(self.number, which, strict=True)],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Lean:
    """How a facet leans and bends against its design: rise in x, rise in y, bow in x, bow in y, twist.

    values (5,): [rad, rad, 1/m, 1/m, 1/m]; covariance (5, 5).
    star (n,): HIP number of each point of light, -1 where none.
    residual (n,): Distance from its star over sigma, NaN where none.
    probability: That no other hypothesis is the right one.
    """

    values: FloatArray
    covariance: FloatArray
    star: IntArray
    residual: FloatArray
    probability: float


def slopes_of(values: FloatArray, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what lean and bows add to the design's slopes at points."""
    rise_x, rise_y, bow_x, bow_y, twist = values
    return rise_x + bow_x * x_m + twist * y_m, rise_y + twist * x_m + bow_y * y_m


def seen_directions(light: FacetLight, values: FloatArray, sights: FloatArray | None = None) -> FloatArray:
    """Return where in the sky each point of light comes from, shape (n, 3) in the facet's frame.

    n ~ unit(camera - P) + unit(star) (spec 003 C-10), solved for the star: the sight mirrored at the normal.
    """
    rays = light.sights if sights is None else sights
    design = light.facet.design
    points = light.eye_m + design.intersect(light.eye_m, rays)[:, None] * rays
    slope_x, slope_y = design.gradient(points[:, 0], points[:, 1])
    more_x, more_y = slopes_of(values, points[:, 0], points[:, 1])
    normal = np.stack([-slope_x - more_x, -slope_y - more_y, np.ones(len(rays))], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(rays - 2 * (rays * normal).sum(axis=1, keepdims=True) * normal)


def sky_area(light: FacetLight) -> float:
    """Return the solid angle of sky that a facet shows, by the design [sr]."""
    corners = light.facet.corners_m - light.eye_m
    seen = seen_directions(light, np.zeros(5), corners / np.linalg.norm(corners, axis=1, keepdims=True))
    x, y = np.einsum("ij,nj->in", _across(seen.mean(axis=0)[None])[0], seen)
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _across(directions: FloatArray) -> FloatArray:
    """Return two unit vectors across each direction, shape (n, 2, 3)."""
    axis = np.where(np.abs(directions[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(directions, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], axis=1)


def _jacobian(light: FacetLight, values: FloatArray, across: FloatArray) -> FloatArray:
    """Return the derivative of the seen directions, across, by the five numbers, shape (n, 2, 5)."""
    columns = []
    for step in 1e-6 * np.eye(5):
        change = (seen_directions(light, values + step) - seen_directions(light, values - step)) / 2e-6
        columns.append(np.einsum("nij,nj->ni", across, change))
    return np.stack(columns, axis=-1)


def _noise(light: FacetLight, values: FloatArray, across: FloatArray) -> FloatArray:
    """Return the covariance of the seen directions, across, from the image points, shape (n, 2, 2) [rad^2]."""
    columns = []
    for axis in range(2):
        step = 0.1 * light.d_sight_d_px[:, :, axis]
        change = seen_directions(light, values, light.sights + step) - seen_directions(
            light, values, light.sights - step
        )
        columns.append(np.einsum("nij,nj->ni", across, change) / 0.2)
    by_px = np.stack(columns, axis=-1)
    return np.asarray(np.einsum("nik,njk->nij", by_px, by_px) * (light.sigma_px**2)[:, None, None])


def identify(
    light: FacetLight, sky: SkyOfFacet, start: FloatArray, prior: FloatArray, sky_sigma_rad: float
) -> Lean | None:
    """Find which stars the points of light are, and lean and bows with them.

    start (5,), prior (5,): Expected values and their standard deviations.
    sky_sigma_rad: Of a star's direction, each way: refraction and clock within one photo.
    Returns: The likeliest hypothesis with its probability, or None where no star is near any point.

    A hypothesis is a lean at which one point of light is one star. Its likelihood counts all points: each is a star at
    its distance with its brightness, or strange. Hypotheses with the same lean are one; the probability is the share of
    the best in the sum over all, a facet that shows nothing but strange points among them.
    """
    across = _across(seen_directions(light, start))
    base = seen_directions(light, start)
    by_lean = _jacobian(light, start, across)
    cover = _noise(light, start, across)
    # Bows are not known yet: with their prior they widen what a star may be off.
    cover = cover + np.einsum("nik,k,njk->nij", by_lean[:, :, 2:], prior[2:] ** 2, by_lean[:, :, 2:])
    cover = cover + sky_sigma_rad**2 * np.eye(2)
    reach = 3.5 * float(prior[:2].max()) * float(np.linalg.norm(by_lean[:, :, :2], axis=(1, 2)).max())
    # Of 40,000 stars above, those near any point of their photo: a few hundred.
    closest = [(one @ base[light.photo == p].T).max(axis=1, initial=-1.0) for p, one in enumerate(sky.directions)]
    sky = sky.chosen([np.flatnonzero(one > np.cos(min(reach, 0.3))) for one in closest])
    near = [np.flatnonzero(sky.directions[p] @ base[n] > np.cos(min(reach, 0.3))) for n, p in enumerate(light.photo)]
    offset = [
        np.einsum("ij,mj->mi", across[n], sky.directions[p][near[n]] - base[n]) for n, p in enumerate(light.photo)
    ]
    brightness = [
        np.exp(-0.5 * ((light.magnitude[n] - sky.magnitude[p][near[n]]) / _MAGNITUDE_SIGMA) ** 2)
        / (np.sqrt(2 * np.pi) * _MAGNITUDE_SIGMA)
        for n, p in enumerate(light.photo)
    ]
    inverse = np.linalg.inv(cover)
    density = (1 - _STRANGE) / (2 * np.pi * np.sqrt(np.linalg.det(cover)))
    # Strange points are anywhere in the window, of any brightness within five magnitudes.
    strange = _STRANGE / (np.pi * reach**2) / 5.0
    turn = np.linalg.inv(by_lean[:, :, :2])
    # The right lean puts most of the brightest points on stars: any of them proposes it.
    leans = [offset[n] @ turn[n].T for n in np.argsort(light.magnitude)[:_PROPOSING]]
    candidates = np.concatenate(leans) if leans else np.zeros((0, 2))
    candidates = candidates[(np.abs(candidates) < 3.5 * prior[:2]).all(axis=1)]
    if not len(candidates):
        return None

    # Whitened, a squared distance is a plain sum.
    white = np.linalg.cholesky(inverse)
    flat = [offset[n] @ white[n] for n in range(light.photo.size)]
    by_white = np.einsum("nki,nkl->nil", white, by_lean[:, :, :2])

    def score(lean: FloatArray) -> FloatArray:
        """Return the logarithm of likelihood times prior of leans (k, 2)."""
        total = -0.5 * ((lean / prior[:2]) ** 2).sum(axis=1)
        for n in range(light.photo.size):
            at = lean @ by_white[n].T
            squares = (flat[n][:, 0] - at[:, :1]) ** 2 + (flat[n][:, 1] - at[:, 1:]) ** 2
            share = np.exp(-0.5 * squares) @ brightness[n] * density[n]
            total = total + np.log(share + strange)
        return np.asarray(total)

    scores = score(candidates)
    best = int(np.argmax(scores))
    width = np.sqrt(np.diagonal(turn @ cover @ turn.transpose(0, 2, 1), axis1=1, axis2=2)).mean(axis=0)
    apart = (np.abs(candidates - candidates[best]) > _SAME * width).any(axis=1)
    nothing = light.photo.size * np.log(strange)
    # One peak stands for all its members: the others count once each.
    others = np.logaddexp.reduce(np.append(_peaks(candidates[apart], scores[apart], width), nothing))
    probability = float(1 / (1 + np.exp(np.clip(others - scores[best], -700, 700))))
    values = start + np.append(candidates[best], [0.0, 0.0, 0.0])
    known = np.append(2 * width, prior[2:])
    return _adjust(light, sky, values, start, prior, known, sky_sigma_rad, probability)


def _peaks(leans: FloatArray, scores: FloatArray, width: FloatArray) -> FloatArray:
    """Return the best score of each group of leans within a few standard deviations."""
    found: list[float] = []
    order = np.argsort(scores)[::-1][:200]
    leans, scores = leans[order], scores[order]
    free: BoolArray = np.ones(len(leans), dtype=bool)
    for number in range(len(leans)):
        if free[number]:
            found.append(float(scores[number]))
            free &= (np.abs(leans - leans[number]) > _SAME * width).any(axis=1)
    return np.array(found)


def _adjust(
    light: FacetLight,
    sky: SkyOfFacet,
    values: FloatArray,
    start: FloatArray,
    prior: FloatArray,
    known: FloatArray,
    sky_sigma_rad: float,
    probability: float,
) -> Lean:
    """Least squares of lean and bows over all points that are a star, stars chosen again after each step."""
    count = light.photo.size
    star, residual, distance = np.full(count, -1, dtype=np.intp), np.full(count, np.nan), np.full(count, np.inf)
    # The hypothesis knows the lean much better than the prior does.
    normal = np.diag(1 / known**2)
    for _ in range(_ROUNDS):
        seen = seen_directions(light, values)
        across = _across(seen)
        by_values = _jacobian(light, values, across)
        cover = _noise(light, values, across) + sky_sigma_rad**2 * np.eye(2)
        unknown = np.linalg.inv(normal)
        wide = cover + np.einsum("nik,kl,njl->nij", by_values, unknown, by_values)
        wide_inverse, inverse = np.linalg.inv(wide), np.linalg.inv(cover)
        normal, right = np.diag(1 / prior**2), (start - values) / prior**2
        star[:], residual[:], distance[:] = -1, np.nan, np.inf
        misses = np.zeros((count, 2))
        for n, photo in enumerate(light.photo):
            if not len(sky.directions[photo]):
                continue
            miss = np.einsum("ij,mj->mi", across[n], sky.directions[photo] - seen[n])
            ahead = sky.directions[photo] @ seen[n] > 0
            off = np.where(ahead, np.einsum("mi,ij,mj->m", miss, wide_inverse[n], miss), np.inf)
            nearest = int(np.argmin(off))
            if off[nearest] <= _TOO_FAR**2:
                star[n], distance[n], misses[n] = sky.number[photo][nearest], off[nearest], miss[nearest]
        # A star is one point of light of a photo: of several that are near it the nearest.
        same = (star[:, None] == star) & (light.photo[:, None] == light.photo)
        star[(same & (distance < distance[:, None])).any(axis=1)] = -1
        for n in np.flatnonzero(star >= 0).tolist():
            residual[n] = float(np.sqrt(misses[n] @ inverse[n] @ misses[n]))
            weighted = by_values[n].T @ inverse[n]
            normal += weighted @ by_values[n]
            right += weighted @ misses[n]
        step = np.linalg.solve(normal, right)
        values = values + step
        if np.abs(step[:2]).max() < 1e-8:
            break
    else:
        # Stars that change with every step are not known, however likely the hypothesis was.
        probability = 0.0
    return Lean(values, np.asarray(np.linalg.inv(normal), dtype=np.float64), star, residual, probability)


def linear_response(
    light: FacetLight, moved: FacetLight, lean: Lean, sky_shift: FloatArray, sky_sigma_rad: float
) -> FloatArray:
    """Return how lean and bows change when sights and camera are those of `moved`, or stars move by a shift (n, 3).

    sky_sigma_rad: As in the adjustment: its weights are those of the covariance.
    """
    used = lean.star >= 0
    seen = seen_directions(light, lean.values)
    across = _across(seen)
    change = np.einsum("nij,nj->ni", across, seen_directions(moved, lean.values) - seen - sky_shift)
    by_values = _jacobian(light, lean.values, across)
    inverse = np.linalg.inv(_noise(light, lean.values, across) + sky_sigma_rad**2 * np.eye(2))
    right = np.einsum("nki,nkl,nl->i", by_values[used], inverse[used], -change[used])
    return np.asarray(lean.covariance @ right)
