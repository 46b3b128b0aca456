"""The turn of a facet that makes its image of the source what the photos show."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.overlay.source_image import FacetPixels, Source, seen_places
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Light that differs by less than this many sigmas of a pixel shows no edge of a source.
_CONTRAST = 6.0
#: Side of the squares whose pixels may share an error: larger than the blur of every lens.
_BLOCK_PX = 12
_ITERATIONS = 40
#: Steps and turns beyond belong to a direction that the light does not show.
_LONGEST_RAD, FARTHEST_RAD = 0.01, 0.3
#: Of levels [DN]: more than any camera has.
_LARGEST_STEP = 1e6
#: Of the pixels far from an edge every so many are used.
_EVERY = 7
#: Blur that a fit in one photo starts with against that of the start over all.
_SHARPER = 0.5
#: At twice the blur, a pixel eight blurs off an edge sees so little (or misses so little) of the source.
_FLAT = 3e-5
#: Of the pixels that are used (every seventh far from an edge), so many in one square are more than a speck of dirt.
_FEWEST = 5
#: Steps for derivatives: a turn that moves the image by a tenth of a pixel or so, and a share of the blur.
_STEP_RAD, _STEP_BLUR = 1e-5, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class FacetView:
    """One facet in one photo.

    photo: Number of the photo.
    pixels: Its pixels.
    light_dn (n,): Their values.
    noise_dn: Noise of one.
    """

    photo: int
    pixels: FacetPixels
    light_dn: FloatArray
    noise_dn: float

    def only(self, chosen: BoolArray) -> "FacetView":
        """Return some of its pixels."""
        pixels = replace(self.pixels, pixels_px=self.pixels.pixels_px[chosen], rays=self.pixels.rays[chosen])
        return replace(self, pixels=pixels, light_dn=self.light_dn[chosen])

    def some(self) -> BoolArray:
        """Choose every so many of its pixels: enough for levels, and for a turn to start from."""
        return np.asarray(np.arange(len(self.light_dn)) % _EVERY == 0)

    def moved(self, camera: Camera, cam_from_heliostat: RigidTransform, facet: Facet) -> "FacetView":
        """Return the same pixels seen by a camera that stood elsewhere."""
        return replace(self, pixels=FacetPixels.of(camera, cam_from_heliostat, facet, self.pixels.pixels_px))

    @property
    def squares(self) -> IntArray:
        """Number of the square that each pixel lies in, from 0, shape (n,)."""
        square = (self.pixels.pixels_px // _BLOCK_PX).astype(np.int64)
        return np.asarray(np.unique(square[:, 0] * 100_003 + square[:, 1], return_inverse=True)[1])

    @property
    def range_dn(self) -> tuple[float, float]:
        """Dark and bright level; without the brightest and darkest pixels."""
        low, high = np.percentile(self.light_dn, [2, 99])
        return float(low), float(high)

    @property
    def shows_source(self) -> bool:
        """Whether part of it is bright and part of it dark."""
        low, high = self.range_dn
        return high - low > _CONTRAST * self.noise_dn


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Where the pixels of a view look in the source's plane, linear in the turn: over 0.1 mrad exact to 1e-8 rad.

    about_rad (2,): That turn. places_m (2, n): There. by_turn (2, n, 2): Derivatives.
    """

    view: FacetView
    about_rad: FloatArray
    places_m: FloatArray
    by_turn: FloatArray

    @classmethod
    def of(cls, facet: Facet, view: FacetView, source: Source, about_rad: FloatArray) -> "Seen":
        """Trace the pixels of a view about a turn."""

        def places(turn_rad: FloatArray) -> FloatArray:
            return np.asarray(np.nan_to_num(seen_places(view.pixels, facet, turn_rad, source), nan=1e6))

        steps = _STEP_RAD * np.eye(2)
        by_turn = [(places(about_rad + step) - places(about_rad - step)) / (2 * _STEP_RAD) for step in steps]
        return cls(view, about_rad, places(about_rad), np.stack(by_turn, axis=-1))

    @property
    def reach_m(self) -> float:
        """How far a turn moves what a pixel sees of the source's plane [m/rad]."""
        return float(np.sqrt(abs(np.linalg.det(np.median(self.by_turn, axis=1)))))

    def places(self, turn_rad: FloatArray) -> FloatArray:
        """Return where the pixels look with a turn, shape (2, n) [m]."""
        return np.asarray(self.places_m + self.by_turn @ (turn_rad - self.about_rad))


@dataclass(frozen=True, slots=True, eq=False)
class ViewTurn:
    """The turn of one facet as one photo shows it.

    view: Facet and photo.
    state: Turn [rad], dark level, gain, log of blur.
    information (2, 2): Of the turn, levels and blur left free [1/rad^2].
    scores (2, 2): Covariance of what drives it, from residuals summed over squares of pixels.
    weights (2, n): Derivatives by the turn, clear of levels and blur.
    residual (n,): Light minus model over noise.
    """

    view: FacetView
    state: FloatArray
    information: FloatArray
    scores: FloatArray
    weights: FloatArray
    residual: FloatArray

    @property
    def turn_rad(self) -> FloatArray:
        """Normal against the design's, with the signs of slope errors, shape (2,) [rad]."""
        return self.state[:2]

    @property
    def gain_dn(self) -> float:
        """By how much the source is brighter than what is beside it [DN]."""
        return float(self.state[3])

    def drive(self, facet: Facet, moved: FacetView, source: Source) -> FloatArray:
        """Return what drives the turn when the camera or the source is elsewhere; information^-1 of it is the turn."""
        places = np.nan_to_num(seen_places(moved.pixels, facet, self.turn_rad, source), nan=1e6)
        return np.asarray(-self.weights @ (_residual_at(moved, source, places, self.state[2:]) - self.residual))


def turn_in_view(facet: Facet, view: FacetView, source: Source, start_rad: FloatArray) -> ViewTurn:
    """Fit the turn of a facet to its light in one photo.

    The model of a pixel is a dark level plus a gain times the share of the source that it sees with blur. Errors that
    pixels of one square share (short waves of the facet, blur of another form) are in the scores: they are those of
    sums over squares (White, Econometrica 48 (1980) 817, by clusters).
    """
    start = start_state([view], source, start_rad)
    start[4] += np.log(_SHARPER)
    state, _ = descend([Seen.of(facet, view.only(view.some()), source, start_rad)], source, start)
    seen = Seen.of(facet, view, source, state[:2])
    # Pixels far from an edge know nothing of the turn.
    share = source.brightness(seen.places_m, 2 * float(np.exp(state[4])))
    chosen = view.some() | ((share > _FLAT) & (share < 1 - _FLAT))
    view = view.only(chosen)
    seen = replace(seen, view=view, places_m=seen.places_m[:, chosen], by_turn=seen.by_turn[:, chosen])
    state, _ = descend([seen], source, state)
    residual, jacobian = _linear([seen], source, state)
    levels = jacobian[:, 2:]
    # What levels and blur can explain is taken out.
    weights = jacobian[:, :2] - levels @ np.linalg.lstsq(levels, jacobian[:, :2], rcond=1e-9)[0]
    scores = _sums_over_squares(view, residual, weights)
    return ViewTurn(view, state, weights.T @ weights, scores, weights.T, residual)


def has_foreign_light(facet: Facet, one: ViewTurn, source: Source, slope_rad: float, blur_m: float) -> bool:
    """Return whether pixels of one square, far from every edge, are bright where they should be dark, or vice versa.

    Far is where a normal distribution of edges, of waves and blur, has less than `_FLAT`.
    slope_rad: RMS slope of the facet's waves.
    blur_m: Of the photo in the source's plane, standard deviation.
    """
    seen = Seen.of(facet, one.view, source, one.turn_rad)
    share = source.brightness(seen.places_m, float(np.hypot(slope_rad * seen.reach_m, blur_m)))
    deep = (share < _FLAT) | (share > 1 - _FLAT)
    if not deep.any():
        return False
    dark, gain = one.state[2:4]
    off = (one.view.light_dn[deep] - dark) / gain - np.rint(share[deep])
    return bool(np.bincount(one.view.squares[deep], np.abs(off) > 0.5).max() >= _FEWEST)


def residual_of_view(facet: Facet, one: ViewTurn, source: Source) -> Callable[[FloatArray, Source], FloatArray]:
    """Return what gives light minus model over noise of one photo for a state and a source, linear about its turn."""
    seen = Seen.of(facet, one.view, source, one.turn_rad)
    return lambda state, other: residuals([seen], other, state)


def _residual_at(view: FacetView, source: Source, places_m: FloatArray, levels: FloatArray) -> FloatArray:
    dark, gain, log_blur = levels
    share = source.brightness(places_m, float(np.exp(np.clip(log_blur, -20, 5))))
    return np.asarray((view.light_dn - dark - gain * share) / view.noise_dn)


def residuals(seen: Sequence[Seen], source: Source, state: FloatArray) -> FloatArray:
    """Return light minus model over noise, all views in a row."""
    return np.concatenate(
        [
            _residual_at(one.view, source, one.places(state[:2]), state[2 + 3 * k : 5 + 3 * k])
            for k, one in enumerate(seen)
        ]
    )


def _linear(seen: Sequence[Seen], source: Source, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the residual and its derivatives (m, p)."""
    residual = residuals(seen, source, state)
    jacobian = np.zeros((residual.size, state.size))
    row = 0
    for number, one in enumerate(seen):
        rows = slice(row, row + len(one.view.light_dn))
        own = slice(2 + 3 * number, 5 + 3 * number)
        _, gain, log_blur = state[own]
        blur = float(np.exp(np.clip(log_blur, -20, 5)))
        places = one.places(state[:2])
        share = source.brightness(places, blur)
        by_place = []
        for axis in range(2):
            step = _STEP_BLUR * blur * np.eye(2)[:, axis : axis + 1]
            change = source.brightness(places + step, blur) - source.brightness(places - step, blur)
            by_place.append(change / (2 * _STEP_BLUR * blur))
        by_turn = np.einsum("an,ant->nt", np.stack(by_place), one.by_turn)
        jacobian[rows, :2] = -gain * by_turn / one.view.noise_dn
        jacobian[rows, own.start] = -1 / one.view.noise_dn
        jacobian[rows, own.start + 1] = -share / one.view.noise_dn
        more = source.brightness(places, blur * np.exp(_STEP_BLUR))
        jacobian[rows, own.start + 2] = -gain * (more - share) / _STEP_BLUR / one.view.noise_dn
        row = rows.stop
    return residual, jacobian


def start_state(views: Sequence[FacetView], source: Source, turn: FloatArray) -> FloatArray:
    """Return a start with much blur, so that edges far off still pull."""
    state = np.concatenate([turn, np.zeros(3 * len(views))])
    for number, view in enumerate(views):
        low, high = view.range_dn
        state[2 + 3 * number : 5 + 3 * number] = low, high - low, np.log(0.15 * min(source.half_m))
    return state


def descend(seen: Sequence[Seen], source: Source, state: FloatArray) -> tuple[FloatArray, float]:
    """Minimise the residual by Levenberg and Marquardt; return the state and its sum of squares."""
    damping = 1e-3
    residual, jacobian = _linear(seen, source, state)
    cost = float(residual @ residual)
    for _ in range(_ITERATIONS):
        products, gradient = jacobian.T @ jacobian, jacobian.T @ residual
        scaled = products + damping * np.diag(np.diag(products) + 1e-300)
        step = -np.linalg.solve(scaled, gradient)
        other = state + step
        if (
            not np.abs(step).max() < _LARGEST_STEP
            or np.abs(step[:2]).max() > _LONGEST_RAD
            or np.abs(other[:2]).max() > FARTHEST_RAD
        ):
            damping *= 8
            continue
        changed = residuals(seen, source, other)
        new = float(changed @ changed)
        if new < cost:
            done = cost - new < 1e-6 * cost
            state, cost, damping = other, new, max(damping / 5, 1e-12)
            residual, jacobian = _linear(seen, source, state)
            if done:
                break
        else:
            damping *= 8
            if damping > 1e12:
                break
    return state, cost


def _sums_over_squares(view: FacetView, residual: FloatArray, jacobian: FloatArray) -> FloatArray:
    number = view.squares
    scores = jacobian * residual[:, None]
    sums = np.stack([np.bincount(number, column) for column in scores.T], axis=1)
    return np.asarray(sums.T @ sums)
