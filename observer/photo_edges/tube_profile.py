"""The absorber tube in a photo: where the metal's axis is, by the light that metal, glass and background send.

Beside a bare tube a photo shows what is behind it, which changes over a few pixels where clouds are mirrored. In glass
one looks through two walls beside the metal. Across the tube there are then, beside each other: what is behind it,
beyond the glass; the same through four faces, less what Fresnel's formulas say they reflect; what the faces throw back,
which differs from side to side and is not known; the tube's own reflection, which the glass, a prism there, turns into
view on one side; and the metal, on which the near wall shows its surroundings. Of this only the metal's edges stand
where the axis says. Levels of brightness beside them, or the steepest place, put a tube of 8 pixels 0.03 to 0.08 px
aside, all photos to the same height: 2.4 mm in path-traced photos, and 1 mm for a bare tube.

Here the whole profile is compared with what it consists of, each part with the amplitude that it may have (linear
unknowns with priors, relative to what is seen beyond the receiver), blurred by the lens and the pixel, for a few rows
together. The axis and the blur are what remains (variable projection, Gauss-Newton).

Where targets in the photo tell how its edges are blurred (`photogrammetry.centers.edge_shape`), that is the blur, as
far as their scatter and the tube's other place leave it; what the walls throw back is that of sky, ground and mirror by
the laws of reflection (`observer.photo_edges.thrown_light`), and amplitudes are mostly those of the whole photo.

Rays across a concentric tube keep their distance b from the axis (Bouguer), so that glass leaves the metal's edges
where they are.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.validate import FloatArray, IntArray
from observer.photo_edges.rectify import PixelSamples
from observer.photo_edges.thrown_light import face_reflectances, thrown_light
from observer.trough.collector import Collector, GlassTube
from photogrammetry.centers import EdgeShape

#: Rows that are taken together.
ROWS_TOGETHER = 16
#: The profile is tabulated this finely [m], and as far as the largest blur reaches beyond the pixels that are used [its
#: standard deviations], in whole hundreds of steps, which Fourier transforms like.
_STEP_M, _BLUR_REACH, _EVEN_STEPS = 0.25e-3, 4.0, 100
#: Pixels beyond the receiver that are used.
BEYOND_PX = 3.0
#: Pixels are put together in bins of so many to a pixel's width.
_BINS_PER_PX = 3
#: Brightness of the metal, relative to what is beyond the receiver: its mean is free; how it changes over the tube's
#: half width (Legendre polynomials of the degrees 1 to 4) has this standard deviation. Faces reflect 0.07 of what is
#: around.
_METAL_DEGREE, _METAL_MEAN, _METAL_SIGMA = 4, 0.25, 0.12
#: What is behind the tube changes by this in 20 mm, as a slope and as a bend.
_SLOPE_SIGMA, _BEND_SIGMA, _SCALE_M = 0.1, 0.05, 0.02
#: What both walls throw back beside the metal, mean and standard deviation: 0.17 of what is around, dark or bright.
_THROWN_MEAN, _THROWN_SIGMA = 0.05, 0.07
#: The same beside what the laws of reflection say, which need edges whose shape is known: walls throw back the horizon,
#: a step of a tenth of the metal's edge, near that edge, and a blur that is not as assumed looks the same.
_REST_SIGMA = 0.03
#: Light from the sky, the ground and the mirror, relative to what is beyond the receiver: means, and one sigma.
_AROUND, _AROUND_SIGMA = (1.0, 0.5, 1.0), 0.4
#: Rows of a photo show much the same: this part of the variance of amplitudes is each group's own. Each for itself, a
#: tube along the pixels has as many amplitudes as pixels across. From 0.1 to 0.5 heights differ by a tenth of a
#: millimetre. All of it where the shape of edges is not known, or amplitudes take up together what the blur lacks, and
#: of a bare tube, which has few of them.
_OWN_SHARE = 0.3
#: Light that leaves the wall of the glass beyond its inner face comes from the side.
_WALL_MEAN, _WALL_SIGMA = 0.7, 0.3
#: The tube's reflection in the prism: how dark, and the slope errors of the mirror that displace it [rad].
_DARK_MEAN, _DARK_SIGMA, _SLOPES_RAD = 0.9, 0.3, 3e-3
#: What the glass around the reflection takes off.
_RING = 0.12
#: How far the glass is beside the metal, and how much thicker or thinner the metal may be [m].
_GLASS_OFF_M, _RADIUS_SIGMA_M = 4e-3, 1e-3
#: Blur of the lens, start and prior [px].
_BLUR_PX, _BLUR_SIGMA_PX = 0.5, 0.2
_LEAST_BLUR_PX, _MOST_BLUR_PX = 0.2, 3.0
#: Where targets tell it, they stand at the mirror's rims and the tube in the middle of the photo. A lens that shows 0.6
#: of the contrast in the middle and 0.5 at the rims, at a quarter of a period per pixel, blurs with 0.64 and 0.75 px
#: there; half of the difference, as a standard deviation. Focus adds less: from 12 to 13.5 m, with an aperture of 2 mm,
#: pixels of 0.25 mrad and a lens focused at either, a disc of 0.07 px, 0.02 as a standard deviation [px].
_PLACE_SIGMA_PX = 0.05
#: What a pixel may be off relative to the background, beside which amplitudes are held against their priors. What
#: residuals say of it goes into standard deviations alone: noise does not make priors better.
_NOISE = 0.02
#: Less information on an axis than this is rounding: a standard deviation of a kilometre [1/m^2]; and how exact, at
#: least, variances are that tell something.
_NOTHING_KNOWN, _ROUNDING = 1e-6, 1e-6
#: Where chance makes residuals as large as those of a group less often than this, they are its own.
_CHANCE = 1e-3
#: Rounds of the fit, until neither the blur nor the axes, as a root mean square, move by more than this, and no axis by
#: so many times as much; each is some ten times nearer than the one before, so that what is left is a fiftieth of what
#: rows share besides, and a thirtieth of a group's own sigma [px].
_ROUNDS, _SETTLED_PX, _ONE_GROUP = 6, 4e-3, 3.0
#: The axis is not further from where the edges put it [px].
_FURTHEST_PX = 1.5


class TubeByProfile(NamedTuple):
    """Where the axis is seen, for each row.

    angle_rad (m,): Angle across the trough; NaN where it was not found: further away than `_FURTHEST_PX`, nothing shown
        beyond it, or brightness that does not change with the axis [rad].
    sigma_rad (m,): Standard deviation of the group of rows that a row belongs to, by which groups scatter; infinite
        where it was not found [rad].
    shared_rad: Standard deviation of what all rows have in common, by the blur and by brightnesses that they share
        [rad].
    radius_m (m,): Radius of the metal as its edges are apart [m].
    rows (m,): How many rows the group has.
    """

    angle_rad: FloatArray
    sigma_rad: FloatArray
    shared_rad: float
    radius_m: FloatArray
    rows: IntArray


class Sighting(NamedTuple):
    """How a photo sees the tube.

    eye_x_m, eye_z_m: The eye [m].
    height_m: Its height over the plane of the samples [m].
    distance_m: How far it is from the axis, across the tube [m].
    pixel_m: What a pixel covers there [m].
    axis_m: Where the axis is expected, x and z [m].
    edges: How edges are blurred across the tube; None: a Gaussian, its width from the tube itself.
    """

    eye_x_m: float
    height_m: float
    distance_m: float
    pixel_m: float
    axis_m: tuple[float, float]
    eye_z_m: float
    edges: EdgeShape | None = None

    @property
    def down(self) -> tuple[float, float]:
        """Direction of the line of sight through the axis, x and z."""
        to_x, to_z = self.axis_m[0] - self.eye_x_m, self.axis_m[1] - self.eye_z_m
        length = float(np.hypot(to_x, to_z))
        return to_x / length, to_z / length


def find_axis(
    samples: PixelSamples,
    row: IntArray,
    y_m: FloatArray,
    angle_rad: FloatArray,
    sighting: Sighting,
    collector: Collector,
) -> TubeByProfile:
    """Find the axis of a tube.

    Shapes: y_m (m,), angle_rad (m,).
    samples: Pixels on a plane near the axis.
    row (m,): Rows of the samples in which both edges were found, ascending.
    y_m: Their places along the tube [m].
    angle_rad: Under which angle the middle between the edges is seen [rad].
    """
    if row.size == 0:
        return TubeByProfile(np.zeros(0), np.zeros(0), 0.0, np.zeros(0), np.zeros(0, dtype=np.intp))
    _, group = np.unique(row // ROWS_TOGETHER, return_inverse=True)
    start = _straight(group, y_m, angle_rad)
    profiles = _profiles(samples, row, group, start, sighting, collector)
    fit = _fit(profiles, sighting, collector)
    angle = start + (fit.middle_m / sighting.distance_m)[group]
    good = (np.abs(fit.middle_m) < _FURTHEST_PX * sighting.pixel_m) & np.isfinite(fit.sigma_m)
    return TubeByProfile(
        np.where(good[group], angle, np.nan),
        (fit.sigma_m / sighting.distance_m)[group],
        fit.shared_m / sighting.distance_m,
        (collector.absorber_diameter_m / 2 + fit.wider_m)[group],
        np.bincount(group)[group],
    )


def _straight(group: IntArray, y_m: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Return the angles of a line through the mean of each group that leans as the means beside it say."""
    count = np.bincount(group)
    y, mean = (np.bincount(group, values) / count for values in (y_m, angle_rad))
    lean = np.gradient(mean, y) if count.size > 1 else np.zeros(1)
    return np.asarray(mean[group] + lean[group] * (y_m - y[group]))


class _Profiles(NamedTuple):
    """Mean brightness over the distance from the expected axis, of g groups in k bins.

    beside_m (g, k): Mean distance of the pixels [m].
    light (g, k): Their mean brightness relative to that beyond the receiver.
    number (g, k): How many they are.
    """

    beside_m: FloatArray
    light: FloatArray
    number: FloatArray


def _profiles(
    samples: PixelSamples, row: IntArray, group: IntArray, start: FloatArray, sighting: Sighting, collector: Collector
) -> _Profiles:
    outer = collector.receiver_diameter_m / 2
    bin_m = sighting.pixel_m / _BINS_PER_PX
    reach = int(np.ceil((outer + BEYOND_PX * sighting.pixel_m) / bin_m))
    n, groups = 2 * reach + 1, int(group.max()) + 1
    # Sines of angles between lines of sight, by lengths: functions of angles take twice as long for so many pixels.
    middle_m = sighting.eye_x_m + sighting.height_m * np.tan(start)
    scale, x_m, values = sighting.distance_m * np.cos(start), samples.x_m[row], samples.values_dn[row]
    beside = x_m - middle_m[:, None, None].astype(np.float32)
    beside *= scale[:, None, None].astype(np.float32)
    x_m -= np.float32(sighting.eye_x_m)
    beside /= np.sqrt(x_m * x_m + np.float32(sighting.height_m**2))
    place = np.rint(beside * np.float32(1 / bin_m)).astype(np.intp)
    place += reach
    inside = np.flatnonzero((place >= 0) & (place < n) & np.isfinite(values))
    place += group[:, None, None] * n
    key, light, mean = (one.ravel()[inside] for one in (place, values, beside))
    count, light, mean = (np.bincount(key, weights, groups * n).reshape(groups, n) for weights in (None, light, mean))
    some = np.maximum(count, 1)
    middles = bin_m * np.arange(-reach, reach + 1)
    beyond = np.abs(middles) > outer + 0.5 * sighting.pixel_m
    known = count[:, beyond].sum(axis=1)
    level = light[:, beyond].sum(axis=1) / np.maximum(known, 1)
    # Light that nothing can be compared with says nothing.
    count = np.where(known[:, None] > 0, count, 0.0)
    light = np.where(count > 0, light, 0.0)
    light = light / some / np.maximum(level, 1e-6)[:, None]
    return _Profiles(np.where(count > 0, mean / some, middles), light, count.astype(np.float64))


class _Fit(NamedTuple):
    """Axis of each group beside where it is expected, and how much wider the metal is [m].

    sigma_m, shared_m: Standard deviations of what is each group's own, and of what all have in common [m].
    """

    middle_m: FloatArray
    sigma_m: FloatArray
    shared_m: float
    wider_m: FloatArray


def _fit(profiles: _Profiles, sighting: Sighting, collector: Collector) -> _Fit:
    most = 0.5 * sighting.pixel_m
    # In each round an axis may move by half a pixel.
    reach = float(np.abs(profiles.beside_m).max()) + _ROUNDS * most
    parts = _Parts.of_view(sighting, collector, reach + _BLUR_REACH * _MOST_BLUR_PX * sighting.pixel_m)
    first, blurred = parts.blurring(sighting.pixel_m, reach)
    groups = len(profiles.number)
    told = sighting.edges
    start, sigma_px = (_BLUR_PX, _BLUR_SIGMA_PX) if told is None else (told.blur_px, _told_sigma_px(told))
    mixed, own_share = (0.0 if told is None else told.mixed), 1.0
    if told is not None and collector.glass is not None:
        own_share = _OWN_SHARE
    middle, blur, scatter = np.zeros(groups), start, 1.0
    weight = profiles.number / _NOISE**2
    spare = np.maximum(np.count_nonzero(profiles.number, axis=1) - 0.5 * len(parts.mean), 1.0)
    each, shared = own_share * parts.sigma**2, (1 - own_share) * parts.sigma**2
    held = 1 / each
    for _ in range(_ROUNDS):
        table = blurred(blur, mixed)
        place = (profiles.beside_m - middle[:, None] + parts.far_m) / _STEP_M - first
        basis = _between(table, place)
        weighted = np.swapaxes(basis * weight[..., None], 1, 2)
        cofactor = np.linalg.inv(weighted @ basis + np.diag(held))
        left = profiles.light - basis @ parts.mean
        right = weighted @ left[..., None]
        # What all groups share, once the own parts of amplitudes are eliminated: with the normal matrix N and the
        # precision P of these, N less what they take is P - P (N + P)^-1 P.
        told_shared = np.diag(groups * held) - held[:, None] * cofactor.sum(axis=0) * held
        common_cofactor = np.linalg.solve(np.eye(len(held)) + shared[:, None] * told_shared, np.diag(shared))
        common = common_cofactor @ (held * (cofactor @ right).sum(axis=0)[:, 0])
        step = (cofactor @ (right + (held * common)[:, None]))[..., 0]
        amplitude = parts.mean + step
        residual = left - (basis @ step[..., None])[..., 0]
        # How the profile changes with the axis and with the blur, less what amplitudes take of that.
        along = np.stack(_changes(amplitude @ table.T, blur * sighting.pixel_m**2, place), axis=2)
        crossed = weighted @ along
        solved = cofactor @ crossed
        weighted_along = np.swapaxes(along * weight[..., None], 1, 2)
        known = weighted_along @ along - np.swapaxes(crossed, 1, 2) @ solved
        pull = (weighted_along @ residual[..., None])[..., 0]
        taken = held[:, None] * solved
        taken = np.vstack([taken[..., 0], taken[..., 1].sum(axis=0)])
        prior = (scatter / sigma_px) ** 2
        information = -taken @ common_cofactor @ taken.T
        information[:-1, :-1] += np.diag(np.maximum(known[:, 0, 0], _NOTHING_KNOWN))
        information[:-1, -1] += known[:, 0, 1]
        information[-1, :-1] += known[:, 0, 1]
        information[-1, -1] += known[:, 1, 1].sum() + prior
        inverse = np.linalg.inv(information)
        moves = inverse @ np.append(pull[:, 0], pull[:, 1].sum() + (start - blur) * prior)
        moved, wider = np.clip(moves[:-1], -most, most), float(moves[-1])
        middle = middle + moved
        blur = float(np.clip(blur + np.clip(wider, -0.2, 0.2), min(_LEAST_BLUR_PX, start), _MOST_BLUR_PX))
        squares = np.sum(weight * residual**2, axis=1)
        # What the model lacks is largest where a support or a cable stands, and errs in all groups without showing
        # there: by the scatter of the other groups alone the tube of a drawn LS-2 was 2 mm too low at a stated 0.3.
        scatter = max(1.0, float(np.sqrt(squares.sum() / spare.sum())))
        largest, usual = float(np.abs(moved).max()), float(np.sqrt(np.mean(moved**2)))
        if max(max(usual, largest / _ONE_GROUP) / sighting.pixel_m, abs(wider)) < _SETTLED_PX:
            break
    # A group that is worse than all together says so of itself.
    other = _by_chance(squares / scatter**2, spare) < _CHANCE
    apart, in_common = _own_and_shared(known[:, 0, 0], np.asarray(inverse[:-1, :-1], dtype=np.float64))
    sigma = np.where(other, np.sqrt(squares / spare), scatter) * apart
    return _Fit(middle, sigma, scatter * in_common, amplitude[:, -1] * _RADIUS_SIGMA_M)


def _own_and_shared(information: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
    """Return by how much groups scatter (g,), and what their mean has besides, as standard deviations.

    information (g,): What each group tells of its own axis if all that groups share is given.
    covariance (g, g): Of all axes; larger than the inverse of that. Where it is not, it is rounding: infinite.
    """
    told = (information > _NOTHING_KNOWN) & (np.diag(covariance) * information > 1 - _ROUNDING)
    weight = np.where(told, information, 0.0)
    total = max(float(weight.sum()), _NOTHING_KNOWN)
    mean = float(weight @ covariance @ weight) / total**2 - 1 / total
    own = 1 / np.sqrt(np.maximum(information, _NOTHING_KNOWN))
    return np.where(told, own, np.inf), float(np.sqrt(max(mean, 0.0)))


def _told_sigma_px(told: EdgeShape) -> float:
    """Return how well the Gaussian part of the blur is told for the tube's place [px]."""
    variance_px2 = np.hypot(told.scatter_px2, 2 * told.width_px * _PLACE_SIGMA_PX)
    return float(np.sqrt(told.blur_px**2 + variance_px2) - told.blur_px)


def _changes(profiles: FloatArray, blur_m2: float, place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how profiles (g, n) change with the axis [1/m] and with the blur [1/px] at places (g, k).

    blur_m2: The blur over a pixel's width, times the square of that [m^2].

    A Gaussian blur of the variance v spreads as heat does: ``df/dv = f'' / 2``.
    """
    count = profiles.shape[1]
    places = _Places.among(place, count)
    # The two samples before each place and the two behind it, at the ends the last one again, and the rises between.
    four = np.clip(places.before[..., None] + np.arange(-1, 3), 0, count - 1)
    four += count * np.arange(len(profiles))[:, None, None]
    rises = np.diff(profiles.ravel().take(four), axis=2)
    first, middle, last = np.moveaxis(rises, 2, 0)
    by_axis = first + middle + places.share * (last - first)
    by_blur = middle - first + places.share * (first - 2 * middle + last)
    return by_axis * (-0.5 / _STEP_M), by_blur * (blur_m2 / _STEP_M**2)


def _by_chance(squares: FloatArray, spare: FloatArray) -> FloatArray:
    """Return how often chance makes sums of squares (g,) of so many spare values larger; 1 where it does often."""
    # Two standard deviations above the mean are reached in more than one case of a hundred.
    large = np.flatnonzero(squares > spare + 2 * np.sqrt(2 * spare))
    often = np.ones(squares.size)
    often[large] = [1 - chi_square_cdf(float(squares[k]), float(spare[k])) for k in large]
    return often


class _Places(NamedTuple):
    """Samples before places between them, and the share of the way to the next."""

    before: IntArray
    share: FloatArray

    @classmethod
    def among(cls, place: FloatArray, count: int) -> "_Places":
        before = np.clip(place.astype(np.intp), 0, count - 2)
        return cls(before, place - before)


def _between(table: FloatArray, place: FloatArray) -> FloatArray:
    """Return rows of a table (n, p) at places (g, k) between them, shape (g, k, p)."""
    before, share = _Places.among(place, len(table))
    low, found = table[before], table[before + 1]
    # In place: to get as much memory again takes longer than the sums.
    found -= low
    found *= share[..., None]
    found += low
    return found


#: Brightness over the distance from the axis, and mean and standard deviation of its amplitude.
_Part = tuple[FloatArray, float, float]


class _Behind(NamedTuple):
    """What is seen beside the metal, brightness over the distance from the axis.

    clear (n,): Share of the light from behind the tube.
    of_sides: Parts whose amplitudes differ from side to side.
    of_both: Parts with one amplitude on both sides.
    beside_metal: Brightness next to the metal's edge.
    """

    clear: FloatArray
    of_sides: list[_Part]
    of_both: list[_Part]
    beside_metal: float

    @classmethod
    def of_view(cls, sighting: Sighting, collector: Collector, beside: FloatArray) -> "_Behind":
        radius, far = collector.absorber_diameter_m / 2, np.abs(beside)
        glass = collector.glass
        if glass is None:
            return cls(1 - _up_to(far, radius), [], [], 1.0)
        outer, inner = glass.outer_diameter_m / 2, glass.inner_diameter_m / 2
        within, wall = _up_to(far, inner) - _up_to(far, radius), _up_to(far, outer) - _up_to(far, inner)
        light = through_glass(glass, beside)
        clear = 1 - _up_to(far, outer) + within * light.passed
        miss = _miss_of_reflection(sighting, collector, beside, light.turned_rad)
        moved = 2 * collector.focal_length_m * _SLOPES_RAD
        dark, less, more = (
            within * light.passed * _darkness(miss + way * moved, radius, outer) for way in (0.0, -1.0, 1.0)
        )
        of_both: list[_Part] = []
        thrown_mean, thrown_sigma = _THROWN_MEAN, _THROWN_SIGMA
        if sighting.edges is not None:
            thrown_mean, thrown_sigma = 0.0, _REST_SIGMA
            thrown = thrown_light(collector, glass, sighting.down, sighting.axis_m[1], beside)
            of_both = [(one, mean, _AROUND_SIGMA) for two, mean in zip(thrown, _AROUND, strict=True) for one in two]
        of_sides = [
            (within, thrown_mean, thrown_sigma),
            (within * (far - radius) / (inner - radius), 0.0, thrown_sigma),
            (wall, _WALL_MEAN, _WALL_SIGMA),
            (-dark, _DARK_MEAN, _DARK_SIGMA),
            ((less - more) / 2, 0.0, 1.0),
        ]
        # The glass beside the metal moves its own edges.
        rim = -np.gradient(clear + wall * _WALL_MEAN, _STEP_M) * (far > (radius + inner) / 2)
        beside_metal = float(np.interp(radius, beside, light.passed)) + _THROWN_MEAN
        return cls(clear, of_sides, [(rim * _GLASS_OFF_M, 0.0, 1.0), *of_both], beside_metal)


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """What a profile consists of, before blur.

    table (p, n): Brightness of each part over the distance from the axis, from -far_m on in steps of _STEP_M.
    mean, sigma (p,): Prior of the amplitudes.
    """

    table: FloatArray
    mean: FloatArray
    sigma: FloatArray
    far_m: float

    @classmethod
    def of_view(cls, sighting: Sighting, collector: Collector, far_m: float) -> "_Parts":
        radius = collector.absorber_diameter_m / 2
        steps = _EVEN_STEPS * int(np.ceil(far_m / (_EVEN_STEPS * _STEP_M)))
        beside = np.asarray(_STEP_M * np.arange(-steps, steps), dtype=np.float64)
        far = np.abs(beside)
        metal = _up_to(far, radius)
        behind = _Behind.of_view(sighting, collector, beside)
        shapes = np.polynomial.legendre.legvander(np.clip(beside / radius, -1, 1), _METAL_DEGREE).T
        parts = [(metal * one, _METAL_MEAN * (k == 0), _METAL_SIGMA if k else 1.0) for k, one in enumerate(shapes)]
        scaled = (far - radius) / _SCALE_M
        for side in ((beside < 0) * 1.0, (beside >= 0) * 1.0):
            clear = side * behind.clear
            parts += [(clear, 1.0, 1.0), (clear * scaled, 0.0, _SLOPE_SIGMA), (clear * scaled**2, 0.0, _BEND_SIGMA)]
            parts += [(side * one, mean, sigma) for one, mean, sigma in behind.of_sides]
        parts += behind.of_both
        # A metal that is wider moves both of its edges outwards.
        edge = np.gradient(metal, _STEP_M) * np.sign(beside)
        parts.append((edge * (behind.beside_metal - _METAL_MEAN) * _RADIUS_SIGMA_M, 0.0, 1.0))
        mean, sigma = np.array([[m, s] for _, m, s in parts]).T
        return cls(np.array([one for one, _, _ in parts]), mean, sigma, steps * _STEP_M)

    def blurring(self, pixel_m: float, reach_m: float) -> tuple[int, Callable[[float, float], FloatArray]]:
        """Return what shows the parts as a pixel does and edges of some blur [px] and mixing, shape (n, p).

        reach_m: Only places up to this distance from the axis are needed; the first one's number is returned before.
        """
        count = self.table.shape[1]
        first = max(0, int((self.far_m - reach_m) / _STEP_M) - 2)
        frequency = np.fft.rfftfreq(count, _STEP_M)
        through_pixel = np.fft.rfft(self.table, axis=1) * np.sinc(frequency * pixel_m)

        def blurred(blur_px: float, mixed: float) -> FloatArray:
            passed = np.exp(-2 * (np.pi * frequency * blur_px * pixel_m) ** 2)
            passed *= 1 - mixed * (1 - np.cos(2 * np.pi * frequency * pixel_m))
            shown = np.fft.irfft(through_pixel * passed, count, axis=1)
            return np.ascontiguousarray(shown[:, first : count - first].T)

        return first, blurred


class GlassLight(NamedTuple):
    """What glass does to lines of sight that pass its axis at a distance.

    passed (n,): Share of light that passes all four faces.
    turned_rad (n,): Angle by which the line is turned, towards the side on which it passes [rad].
    """

    passed: FloatArray
    turned_rad: FloatArray


def through_glass(glass: GlassTube, beside_m: FloatArray) -> GlassLight:
    """Return what two walls of glass do to lines of sight across them, by the laws of Snell and Fresnel.

    Shapes: beside_m (n,), result (n,).

    Beyond the inner face no light passes.
    """
    passed, turned = np.ones(beside_m.shape), np.zeros(beside_m.shape)
    for radius, way in ((glass.outer_diameter_m / 2, -1.0), (glass.inner_diameter_m / 2, 1.0)):
        sine = np.clip(beside_m / radius, -1, 1)
        passed *= (1 - face_reflectances(sine, glass.index)) ** 2
        turned += 2 * way * (np.arcsin(sine) - np.arcsin(sine / glass.index))
    return GlassLight(np.where(np.abs(beside_m) < glass.inner_diameter_m / 2, passed, 0.0), turned)


def _up_to(far_m: FloatArray, limit_m: float) -> FloatArray:
    """Return 1 up to a distance and 0 beyond, a step of the table that the limit parts its share."""
    return np.clip((limit_m - far_m) / _STEP_M + 0.5, 0, 1)


def _darkness(miss_m: FloatArray, radius_m: float, outer_m: float) -> FloatArray:
    """Return what the tube takes off light that passes it at a distance, or ends on it."""
    far = np.abs(miss_m)
    return np.where(far < radius_m, 1.0, np.where(far < outer_m, _RING, 0.0))


def _miss_of_reflection(
    sighting: Sighting, collector: Collector, beside_m: FloatArray, turned_rad: FloatArray
) -> FloatArray:
    """Return how far from the axis lines of sight pass after the mirror behind the tube; infinite beside the mirror."""
    (axis_x, axis_z), (to_x, to_z) = sighting.axis_m, sighting.down
    # Towards larger x, where lines that pass the axis there are turned to.
    way_x = to_x * np.cos(turned_rad) - to_z * np.sin(turned_rad)
    way_z = to_z * np.cos(turned_rad) + to_x * np.sin(turned_rad)
    from_x, from_z = axis_x - beside_m * way_z, axis_z + beside_m * way_x
    four_f = 4 * collector.focal_length_m
    square, linear = way_x**2 / four_f, 2 * from_x * way_x / four_f - way_z
    rest = from_x**2 / four_f - from_z
    root = np.sqrt(np.maximum(linear**2 - 4 * square * rest, 0.0))
    length = -2 * rest / (linear + root)
    x, z = from_x + length * way_x, from_z + length * way_z
    slope = 2 * x / four_f
    against = 2 * (way_z - slope * way_x) / (1 + slope**2)
    back_x, back_z = way_x + against * slope, way_z - against
    miss = ((x - axis_x) * back_z - (z - axis_z) * back_x) / np.hypot(back_x, back_z)
    return np.where((np.abs(x) < collector.aperture_width_m / 2) & (linear > 0), miss, np.inf)
