"""What photos of a mirror's beam can tell of the mirror: pointing of each photo, canting of the facets, focus, scatter.

The expected flux of each facet (`expected_flux`) is fitted to the measured one of several suns at once by least
squares: aim point, brightness and level of each photo, and for all photos the canting of each facet, one curvature,
and the scatter of the beam. The mean of the canting is the pointing, so the canting adds up to zero. What is left
between measured and expected flux is no noise that differs from pixel to pixel but what the model lacks (surface, sun
shape, background), alike over the width of the sun's picture: the covariance takes residuals of such blocks as they
are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calibration.beam.mirror.expected_flux import FluxGrid, Scene, flux_change, sun_kernel, whole_flux
from calibration.beam.mirror.facets import Mirror, Mount, canted, curved, mirror_rotation
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.target_planes import PlaneTarget
from heliogauge.short_repr import ShortRepr
from heliogauge.sunlight.sun_shapes import BuieSun, SunShape
from heliogauge.validate import FloatArray, IntArray, freeze

__all__ = [
    "FluxFit",
    "FluxPhoto",
    "MirrorStand",
    "aureole_ratio",
    "compare_as_it_is",
    "correlation",
    "fit_flux",
    "flux_information",
    "zero_mean_basis",
]

_MOST_STEPS = 25
#: Widths of the blocks within which residuals are taken as alike, in discs of the sun; the largest effect counts.
_BLOCKS = (0.5, 1.0, 1.5)
#: Width of the smaller blocks that all have one variance, in discs of the sun: those of drawn mirrors reach so far.
_SMALL_BLOCK = 0.25
#: Change of a canting that ends the fit: a hundredth of what photos tell [rad].
_SETTLED_RAD = 1e-6
#: Sigma of a canting beyond which it is of no use: the beam of the facet is turned by twice as much, 0.93 mrad, a fifth
#: of the sun's radius [rad].
_TOLD_RAD = 0.1 * 4.65e-3
#: Pairs of facets whose exchange is tried, the nearest first; steps after which an exchange that costs so much more is
#: given up; turns by less than so many sigmas are the same minimum.
_EXCHANGES, _EXCHANGE_STEPS, _HOPELESS, _SAME_SIGMAS = 10, 3, 1.5, 3.0
#: Steps of the differences that stand for derivatives [rad, 1/m, rad].
_STEP_RAD, _STEP_1PM, _STEP_SCATTER_RAD = 1e-4, 2e-4, 2e-4
#: Least and largest scatter: below, the sun's disc hides it; beyond, it is no scatter [rad].
#: Circumsolar ratios that are tried, up to hazy skies; level of the disc's flux below which its skirts begin.
_AUREOLES, _SKIRT = (0.0, 0.01, 0.03, 0.06, 0.1, 0.2, 0.4), 0.02
_LEAST_SCATTER_RAD, _MOST_SCATTER_RAD = 2e-4, 2e-2


@dataclass(frozen=True, slots=True, eq=False)
class MirrorStand:
    """Where a mirror stands, and how it turns.

    position_m (3,): Its middle in the field [m].
    mount: How it turns about its normal.
    """

    position_m: FloatArray
    mount: Mount


@dataclass(frozen=True, slots=True, eq=False)
class FluxPhoto(ShortRepr):
    """The measured flux of one photo.

    name: Of the photo.
    target: The target.
    to_sun (3,): Direction to the sun, in the field.
    grid: Where the flux is known.
    flux_dn (ny, nx): It; NaN where it is not known [DN].
    aim_m (2,): Centre of the light on the target [m].
    sun: Radiance over the angle from the sun's centre.
    """

    name: str
    target: PlaneTarget
    to_sun: FloatArray
    grid: FluxGrid
    flux_dn: FloatArray
    aim_m: FloatArray
    sun: SunShape

    def scene(self, stand: MirrorStand, aim_m: FloatArray, scatter_rad: float) -> Scene:
        """Return the mirror in the light of this photo, aimed at a point of the target [m]."""
        toward = self.target.points(aim_m[None, :])[0] - stand.position_m
        rotation = mirror_rotation(self.to_sun, toward, stand.mount)
        return Scene(stand.position_m, rotation, self.to_sun, self.target, self.sun, scatter_rad)


@dataclass(frozen=True, slots=True, eq=False)
class FluxFit(ShortRepr):
    """A mirror and the photos of its beam brought together.

    canting_rad, sigma_canting_rad (k, 2): Turn of each facet's normal towards +x and +y that was added, and its sigma;
        the mean over the facets is zero [rad].
    curvature_1pm, sigma_curvature_1pm: Curvature that was added to all facets [1/m].
    scatter_rad, sigma_scatter_rad: Scatter of the beam in one direction beyond surface and sun [rad].
    aims_m, sigma_aims_m (n, 2): Where each photo's beam is aimed [m].
    expected_dn: Expected flux of each photo on its grid, brightness and level fitted [DN].
    levels_dn (n,): Of it the level, which the background is taken for [DN].
    correlations (n,): Between measured and expected flux.
    steps: Steps of the fit.
    covariance_canting (2k, 2k): Covariance of the canting, x and y of each facet in turn [rad^2].
    worth: Covariance of the canting over that of white noise of variance one.
    rival_log_odds: Natural logarithm of the odds of the answer against the best one with facets exchanged; infinite
        where no exchange is a minimum of its own, or none was tried.
    """

    canting_rad: FloatArray
    sigma_canting_rad: FloatArray
    curvature_1pm: float
    sigma_curvature_1pm: float
    scatter_rad: float
    sigma_scatter_rad: float
    aims_m: FloatArray
    sigma_aims_m: FloatArray
    expected_dn: tuple[FloatArray, ...]
    levels_dn: FloatArray
    correlations: FloatArray
    steps: int
    covariance_canting: FloatArray
    worth: float = float("nan")
    rival_log_odds: float = float("inf")

    @property
    def is_canting_told(self) -> bool:
        """Whether the photos tell the canting.

        To a fifth of the sun's radius in the beam, RMS over the facets, and with odds of 20 against facets exchanged.
        """
        return self.sigma_canting_rms_rad < _TOLD_RAD and not self.may_be_exchanged

    @property
    def sigma_canting_rms_rad(self) -> float:
        """Sigma of a facet's canting, RMS over facets and axes."""
        return float(np.sqrt(np.mean(self.sigma_canting_rad**2)))

    def sigma_words(self) -> str:
        """Say how sure the canting is, as everywhere: the RMS of the facets' sigmas, and the largest."""
        rms_mrad, most_mrad = 1e3 * self.sigma_canting_rms_rad, 1e3 * float(self.sigma_canting_rad.max())
        return f"sigma of a facet {rms_mrad:.2f} mrad RMS, {most_mrad:.2f} mrad at most"

    @property
    def may_be_exchanged(self) -> bool:
        """Whether the photos say nearly as well that some facets stand where others do: odds below 20."""
        return self.rival_log_odds < float(np.log(20.0))

    @property
    def slope_error_bound_rad(self) -> float:
        """Upper bound (95 %) of a slope error of the normal in one direction: all scatter is taken for it [rad]."""
        return 0.5 * (self.scatter_rad + 1.645 * self.sigma_scatter_rad)


def correlation(first: FloatArray, second: FloatArray) -> float:
    """Return the correlation of two pictures over the pixels that both have."""
    both = np.isfinite(first) & np.isfinite(second)
    a, b = first[both] - first[both].mean(), second[both] - second[both].mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 0 else float("nan")


def compare_as_it_is(
    photos: Sequence[FluxPhoto], mirror: Mirror, stand: MirrorStand, scatter_rad: float = 0.0
) -> FluxFit:
    """Compare photos with a mirror as it is: only aim and brightness of each photo are fitted.

    scatter_rad: Scatter of the beam in one direction beyond the surface [rad].
    InputError: No photo, or a mirror that does not stand before the target.
    EstimationError: The mirror sends no light to the target.
    """
    return _Fit(photos, mirror, stand, scatter_rad, free=False).solve()


def aureole_ratio(photo: FluxPhoto, mirror: Mirror, stand: MirrorStand, scatter_rad: float = 0.0) -> float:
    """Return the circumsolar ratio with which the expected flux has the skirts of the measured one.

    scatter_rad: Scatter of the beam in one direction beyond the surface [rad].
    EstimationError: The mirror sends no light to the target.

    Skirts are where the sun's disc alone gives less than 2 % of the peak; the share of the light there decides. Slope
    errors and blur widen the core and hardly reach so far. The sun's aureole on that day, haze, dirt on the mirror and
    the camera's own halo act alike: without a measured sun shape this is the shape that stands for them. The
    background is taken as removed.
    """
    known = np.isfinite(photo.flux_dn)

    def expected(ratio: float) -> FloatArray:
        scene = replace(photo, sun=BuieSun(ratio)).scene(stand, photo.aim_m, scatter_rad)
        flux = whole_flux(scene, mirror, photo.grid)
        if not float(flux.sum()) > 0:
            raise EstimationError(
                f"{photo.name}: the mirror sends no light to where the beam is; check sun and position"
            )
        return np.asarray(flux, dtype=np.float64)

    disc = expected(0.0)
    skirts = known & (disc < _SKIRT * float(disc.max()))
    wanted = float(photo.flux_dn[skirts].sum() / photo.flux_dn[known].sum())
    shares = [float(one[skirts].sum() / one[known].sum()) for one in (disc, *map(expected, _AUREOLES[1:]))]
    # Shares ascend with the ratio; beyond both ends the end stands.
    return float(np.interp(wanted, shares, _AUREOLES))


def fit_flux(photos: Sequence[FluxPhoto], mirror: Mirror, stand: MirrorStand, scatter_rad: float = 1e-3) -> FluxFit:
    """Fit canting, focus and scatter of a mirror to photos of its beam.

    scatter_rad: Scatter from which the search starts [rad].
    InputError: No photo, or a mirror that does not stand before the target.
    EstimationError: The photos do not determine the parameters, or the fit did not settle.
    """
    return _Fit(photos, mirror, stand, scatter_rad, free=True).solve()


def flux_information(photo: FluxPhoto, mirror: Mirror, stand: MirrorStand, fit: FluxFit) -> FloatArray:
    """Return what a photo tells of canting, curvature and scatter, its own aim, brightness and level taken out.

    fit: Where the mirror is: canting, curvature, scatter.
    Returns (2(k - 1) + 2, same): Normal matrix for residuals in shares of the photo's RMS flux, over all of its
        pixels together; canting in the basis of `zero_mean_basis`, x and y of each mode in turn.
    """
    one = _Fit([photo], mirror, stand, fit.scatter_rad, free=True)
    rows = one.at(_State(fit.canting_rad, fit.curvature_1pm, fit.scatter_rad, photo.aim_m[None, :])).rows
    basis, _ = np.linalg.qr(rows[:, -2:])
    told = rows[:, :-2] - basis @ (basis.T @ rows[:, :-2])
    return np.asarray(told.T @ told)


def zero_mean_basis(facets: int) -> FloatArray:
    """Return an orthonormal basis of cantings that add up to zero, shape (facets, facets - 1)."""
    ones = np.ones((facets, 1)) / np.sqrt(facets)
    return np.asarray(np.linalg.svd(np.eye(facets) - ones @ ones.T)[0][:, : facets - 1])


class _Linear(NamedTuple):
    """Residuals and their derivatives by all parameters, over all photos, and the block of each pixel by each width."""

    residuals: FloatArray
    rows: FloatArray
    blocks: IntArray
    expected: tuple[FloatArray, ...]
    levels: FloatArray


@dataclass(slots=True, eq=False)
class _State:
    """Parameters: canting (k, 2), curvature, scatter, aims (n, 2)."""

    canting: FloatArray
    curvature: float
    scatter: float
    aims: FloatArray


class _Fit:
    """Least squares; brightness and level of each photo are eliminated in closed form."""

    def __init__(
        self,
        photos: Sequence[FluxPhoto],
        mirror: Mirror,
        stand: MirrorStand,
        scatter_rad: float,
        *,
        free: bool,
    ) -> None:
        if not photos:
            raise InputError("flux: no photo can be compared; each needs a beam, a sun and a target of known place")
        self._photos, self._mirror, self._stand = photos, mirror, stand
        self._count = len(mirror.facets)
        self._free = free
        self._state = _State(
            np.zeros((self._count, 2)), 0.0, scatter_rad, np.array([photo.aim_m for photo in photos], dtype=np.float64)
        )
        self._zero_mean = zero_mean_basis(self._count)
        self._globals = 2 * (self._count - 1) + 2 if free else 0

    def solve(self) -> FluxFit:
        steps = self._descend(_MOST_STEPS)
        if steps is None:
            raise EstimationError(
                f"flux: the fit did not settle in {_MOST_STEPS} steps; is it the beam of this mirror, and the sun "
                f"of this time?"
            )
        found = self._result(self._linear(self._state), steps)
        if not self._free or self._count < 2 or not found.is_canting_told:
            return found
        return self._compared_with_exchanged(found)

    def _descend(self, most_steps: int) -> int | None:
        """Go down from where the mirror is; return the steps, None where they were not enough."""
        linear = self._linear(self._state)
        cost, damping = float(linear.residuals @ linear.residuals), 1e-3
        steps = 0
        while steps < most_steps:
            steps += 1
            normal = linear.rows.T @ linear.rows
            gradient = linear.rows.T @ linear.residuals
            self._refuse_undetermined(normal)
            moved = False
            step: FloatArray = np.zeros(gradient.size)
            lower = cost
            for _ in range(8):
                damped = normal + damping * np.diag(np.diag(normal))
                step = np.asarray(np.linalg.solve(damped, gradient))
                trial = self._moved(step)
                attempt = self._linear(trial, derivatives=False)
                lower = float(attempt.residuals @ attempt.residuals)
                if lower < cost:
                    moved, damping = True, damping / 5
                    self._state = trial
                    break
                damping *= 6
            if not moved or self._is_settled(step, cost - lower, cost):
                return steps
            linear = self._linear(self._state)
            cost = float(linear.residuals @ linear.residuals)
        return None

    def _compared_with_exchanged(self, found: FluxFit) -> FluxFit:
        """Look whether the photos say as well, or better, that two facets stand where each other's pictures are.

        Pictures of facets are nearly alike. What tells them apart is how they move with the sun, so there is a minimum
        near each exchange; from the design's canting a fit may run into a wrong one.
        """
        tried: set[tuple[int, int]] = set()
        best, state, cost = found, self._state, self._cost()
        rival = float("inf")
        while True:
            pairs = [pair for pair in self._nearest_pairs(best) if pair not in tried][:_EXCHANGES]
            better = False
            for pair in pairs:
                tried.add(pair)
                settled = self._descend_from(state, pair, cost)
                if settled is None:
                    continue
                other = self._cost()
                apart = float(np.abs(self._state.canting - state.canting).max())
                if apart < _SAME_SIGMAS * float(best.sigma_canting_rad.max()):
                    continue
                # One that is better and does not settle is no answer: then the canting is not determined.
                if other < cost and settled:
                    rival, state, cost, better = cost, self._state, other, True
                    best = self._result(self._linear(self._state), best.steps)
                    tried.clear()
                    break
                rival = min(rival, other)
            if not better:
                break
        self._state = state
        # Residuals are alike over blocks: a unit of information is worth as much less as the covariance is larger.
        return replace(best, rival_log_odds=(rival - cost) / (2 * best.worth))

    def _descend_from(self, state: _State, pair: tuple[int, int], cost: float) -> bool | None:
        """Exchange two facets and go down; return whether that settled, None where it leads to no minimum."""
        try:
            self._state = self._exchanged(state, pair)
            if self._descend(_EXCHANGE_STEPS) is None and self._cost() > _HOPELESS * cost:
                return None
            return self._descend(_MOST_STEPS) is not None
        except EstimationError:
            # No light where the beam is, or none that tells facets apart there: no rival of an answer that has both.
            return None

    def _cost(self) -> float:
        residuals = self._linear(self._state, derivatives=False).residuals
        return float(residuals @ residuals)

    def _landings(self, canting: FloatArray) -> FloatArray:
        """Return where the light of each facet lands in each photo, relative to all of it, shape (k, n, 2) [m]."""
        mirror = canted(curved(self._mirror, self._state.curvature), canting)
        places = np.zeros((self._count, len(self._photos), 2))
        for number, photo in enumerate(self._photos):
            scene = photo.scene(self._stand, self._state.aims[number], self._state.scatter)
            for facet, one in enumerate(mirror.facets):
                points, power = scene.landings_m(one)
                places[facet, number] = power @ points / power.sum()
        return np.asarray(places - places.mean(axis=0))

    def _nearest_pairs(self, fit: FluxFit) -> list[tuple[int, int]]:
        """Return pairs of facets, those whose pictures are nearest to each other first."""
        places = self._landings(fit.canting_rad)
        pairs = [(one, other) for one in range(self._count) for other in range(one)]
        return sorted(pairs, key=lambda pair: float(np.sum((places[pair[0]] - places[pair[1]]) ** 2)))

    def _exchanged(self, state: _State, pair: tuple[int, int]) -> _State:
        """Return the mirror with two facets turned so that their pictures stand where the other's were."""
        self._state = state
        here = self._landings(state.canting)
        canting = state.canting.copy()
        for one, other in (pair, pair[::-1]):
            rates = self._rates(state, one)
            wanted = (here[other] - here[one]).ravel()
            canting[one] += np.linalg.lstsq(rates, wanted, rcond=None)[0]
        return replace(state, canting=canting - canting.mean(axis=0))

    def _rates(self, state: _State, facet: int) -> FloatArray:
        """Return how the landing of a facet moves with its own turn, all photos below each other, (2n, 2) [m/rad]."""
        columns = []
        one = canted(curved(self._mirror, state.curvature), state.canting)
        for axis in (0, 1):
            sides = []
            for sign in (1, -1):
                turn = np.zeros((self._count, 2))
                turn[facet, axis] = sign * _STEP_RAD
                moved = canted(one, turn).facets[facet]
                places = []
                for number, photo in enumerate(self._photos):
                    scene = photo.scene(self._stand, state.aims[number], state.scatter)
                    points, power = scene.landings_m(moved)
                    places.append(power @ points / power.sum())
                sides.append(np.array(places))
            columns.append(((sides[0] - sides[1]) / (2 * _STEP_RAD)).ravel())
        return np.stack(columns, axis=1)

    def _is_settled(self, step: FloatArray, gain: float, cost: float) -> bool:
        small = float(np.abs(step[: max(self._globals - 2, 0)]).max(initial=0.0)) < _SETTLED_RAD
        return (small and gain < 1e-5 * cost) or gain < 1e-7 * cost

    def _moved(self, step: FloatArray) -> _State:
        state = self._state
        aims = state.aims + step[self._globals :].reshape(-1, 2)
        if not self._free:
            return replace(state, aims=aims)
        half = self._count - 1
        canting = state.canting + self._zero_mean @ step[: 2 * half].reshape(half, 2)
        scatter = float(np.clip(state.scatter + step[2 * half + 1], _LEAST_SCATTER_RAD, _MOST_SCATTER_RAD))
        return _State(canting, state.curvature + float(step[2 * half]), scatter, aims)

    def _refuse_undetermined(self, normal: FloatArray) -> None:
        scale = np.sqrt(np.diag(normal))
        if not (scale > 0).all():
            raise EstimationError(
                "flux: a facet sends no light to the targets, so its canting is not seen in the photos"
            )
        values = np.linalg.eigvalsh(normal / scale[:, None] / scale)
        if values[0] < 1e-8:
            raise EstimationError(
                f"flux: {len(self._photos)} photos do not tell the canting of {self._count} facets apart; more "
                f"suns, or fewer "
                "facets"
            )

    def at(self, state: _State) -> _Linear:
        """Return residuals and derivatives where the mirror is so."""
        return self._linear(state)

    # --- model ------------------------------------------------------------------------------------------------------

    def _linear(self, state: _State, *, derivatives: bool = True) -> _Linear:
        mirror = canted(curved(self._mirror, state.curvature), state.canting)
        residuals, rows, blocks, expected, levels = [], [], [], [], []
        first = 0
        for number, photo in enumerate(self._photos):
            scene = photo.scene(self._stand, state.aims[number], state.scatter)
            kernel = sun_kernel(scene, photo.grid)
            whole = whole_flux(scene, mirror, photo.grid, kernel)
            known = np.isfinite(photo.flux_dn)
            model = np.column_stack([whole[known], np.ones(int(known.sum()))])
            measured = photo.flux_dn[known]
            scale, *_ = np.linalg.lstsq(model, measured, rcond=None)
            if not scale[0] > 0:
                raise EstimationError(f"{photo.name}: the expected beam is not where the measured one is")
            # Each photo counts alike, however long it was exposed.
            weight = 1 / (scale[0] * float(np.sqrt(np.mean(whole[known] ** 2))) * np.sqrt(measured.size))
            levels.append(float(scale[1]))
            expected.append(freeze(scale[0] * whole + scale[1]))
            residuals.append(weight * (measured - model @ scale))
            if derivatives:
                part = np.zeros((measured.size, self._globals + 2 * len(self._photos)))
                columns = self._derivatives(state, mirror, photo, scene, whole, kernel)
                chosen = [one[known] for one in columns]
                part[:, : self._globals] = np.column_stack(chosen[:-2]) if self._globals else part[:, :0]
                place = self._globals + 2 * number
                part[:, place : place + 2] = np.column_stack(chosen[-2:])
                # What brightness and level take of each derivative is not seen.
                basis, _ = np.linalg.qr(model)
                part -= basis @ (basis.T @ part)
                rows.append(weight * scale[0] * part)
                blocks.append(
                    np.stack([_blocks(photo, scene, width)[known] for width in (*_BLOCKS, _SMALL_BLOCK)]) + first
                )
                first += int(blocks[-1].max()) + 1
        empty = np.zeros((0, 0))
        return _Linear(
            np.concatenate(residuals),
            np.concatenate(rows) if rows else empty,
            np.concatenate(blocks, axis=1) if blocks else np.zeros((0, 0), dtype=np.intp),
            tuple(expected),
            np.array(levels),
        )

    def _derivatives(
        self,
        state: _State,
        mirror: Mirror,
        photo: FluxPhoto,
        scene: Scene,
        whole: FloatArray,
        kernel: FloatArray,
    ) -> list[FloatArray]:
        """Return the derivatives of the flux by all that is common, then by the aim."""
        found: list[FloatArray] = []
        if self._free:
            by_facet = np.zeros((self._count, 2, *whole.shape))
            for axis in (0, 1):
                turn = np.zeros((self._count, 2))
                turn[:, axis] = _STEP_RAD
                sides = (canted(mirror, turn), canted(mirror, -turn))
                by_facet[:, axis] = flux_change(scene, sides, photo.grid, kernel) / (2 * _STEP_RAD)
            parts = np.einsum("kj,kayx->jayx", self._zero_mean, by_facet)
            found += list(parts.reshape(-1, *whole.shape))
            bent = canted(curved(self._mirror, state.curvature + _STEP_1PM), state.canting)
            found.append((whole_flux(scene, bent, photo.grid, kernel) - whole) / _STEP_1PM)
            wider = replace(scene, scatter_rad=state.scatter + _STEP_SCATTER_RAD)
            found.append((whole_flux(wider, mirror, photo.grid) - whole) / _STEP_SCATTER_RAD)
        up, across = (np.asarray(one) for one in np.gradient(whole, photo.grid.y_m, photo.grid.x_m))
        return [*found, -across, -up]

    def _size(self, covariance: FloatArray) -> float:
        """Return the size of a covariance: that of the canting where it is estimated, else of the aims."""
        count = 2 * (self._count - 1) if self._free and self._count > 1 else len(covariance)
        return float(np.trace(covariance[:count, :count]))

    def _left_out(self, linear: _Linear, normal: FloatArray, index: IntArray) -> FloatArray:
        """Return the covariance by leaving out each block in turn (CR3: MacKinnon and White 1985, for clusters).

        A block that alone determines a parameter then counts with what the others would say of it.
        """
        order = np.argsort(index, kind="stable")
        bounds = np.flatnonzero(np.diff(index[order])) + 1
        ridge = 1e-9 * np.diag(np.diag(normal))
        total = np.zeros_like(normal)
        for chosen in np.split(order, bounds):
            rows = linear.rows[chosen]
            shift = np.linalg.solve(normal - rows.T @ rows + ridge, rows.T @ linear.residuals[chosen])
            total += np.outer(shift, shift)
        return total

    # --- answer -----------------------------------------------------------------------------------------------------

    def _result(self, linear: _Linear, steps: int) -> FluxFit:
        normal = linear.rows.T @ linear.rows
        self._refuse_undetermined(normal)
        left_out = max((self._left_out(linear, normal, index) for index in linear.blocks[:-1]), key=self._size)
        # A few blocks span few directions: in the others that covariance is near zero, by chance.
        even = _alike(linear, normal, linear.blocks[-1])
        covariance = left_out + even
        state, half, globals_ = self._state, self._count - 1, self._globals
        nan = float("nan")
        cantings = np.zeros((2 * self._count, 2 * self._count))
        if self._free:
            # Parameters run facet mode by facet mode, x and y in turn.
            spread = np.asarray(np.kron(self._zero_mean, np.eye(2)), dtype=np.float64)
            sizes = spread @ covariance[: 2 * half, : 2 * half] @ spread.T
            cantings = _sized(spread @ even[: 2 * half, : 2 * half] @ spread.T, sizes, spread)
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        correlations = [
            correlation(photo.flux_dn, one) for photo, one in zip(self._photos, linear.expected, strict=True)
        ]
        return FluxFit(
            freeze(state.canting.copy()),
            freeze(np.sqrt(np.maximum(np.diag(cantings), 0.0)).reshape(-1, 2)),
            state.curvature,
            float(sigma[2 * half]) if self._free else nan,
            state.scatter,
            float(sigma[2 * half + 1]) if self._free else nan,
            freeze(state.aims.copy()),
            freeze(sigma[globals_:].reshape(-1, 2)),
            linear.expected,
            freeze(linear.levels),
            freeze(np.array(correlations)),
            steps,
            freeze(cantings),
            _worth(covariance, normal, 2 * half) if self._free and half else nan,
        )


def _worth(covariance: FloatArray, normal: FloatArray, count: int) -> float:
    """Return the covariance of the first parameters over that of white noise of variance one."""
    unit = np.linalg.inv(normal)[:count, :count]
    return float(np.trace(covariance[:count, :count]) / np.trace(unit))


def _alike(linear: _Linear, normal: FloatArray, index: IntArray) -> FloatArray:
    """Return the covariance where the residuals of all blocks have one variance, and are alike within each.

    A block counts for the variance with what it tells of the parameters; what the parameters took of the residuals is
    given back.
    """
    order = np.argsort(index, kind="stable")
    first = np.concatenate([[0], np.flatnonzero(np.diff(index[order])) + 1])
    count = np.diff(np.append(first, index.size))
    sums = np.add.reduceat(linear.rows[order], first)
    means = np.add.reduceat(linear.residuals[order], first) / count
    told = np.sum((sums / np.sqrt(np.diag(normal))) ** 2, axis=1)
    blocks = float(told.sum() ** 2 / np.sum(told**2))
    spare = max(blocks - normal.shape[0], 0.25 * blocks)
    variance = float(told @ means**2 / told.sum()) * blocks / spare
    inverse = np.linalg.inv(normal)
    return np.asarray(variance * inverse @ (sums.T @ sums) @ inverse)


def _sized(even: FloatArray, sizes: FloatArray, spread: FloatArray) -> FloatArray:
    """Return a covariance with the correlations of one and the variances of another, for cantings that add up to zero.

    Leaving out some dozens of blocks tells how large each error is, but of a covariance of so few samples the smallest
    directions are too small: errors of 24 drawn mirrors were 1.5 of it along its own axes and 1.0 facet by facet. What
    each direction is worth follows from how the flux moves with it, where residuals are alike everywhere.
    """
    scale = np.sqrt(np.maximum(np.diag(sizes), 0.0) / np.maximum(np.diag(even), 1e-300))
    onto = spread @ spread.T
    return np.asarray(onto @ (even * np.outer(scale, scale)) @ onto)


def _blocks(photo: FluxPhoto, scene: Scene, suns: float) -> IntArray:
    """Return the number of the block that each pixel belongs to: so many of the sun's discs wide."""
    width = suns * 2 * 4.65e-3 * float(np.linalg.norm(scene.spread, ord=2))
    column = ((photo.grid.x_m - photo.grid.x_m[0]) / width).astype(np.intp)
    row = ((photo.grid.y_m - photo.grid.y_m[0]) / width).astype(np.intp)
    return np.asarray(row[:, None] * (int(column.max()) + 1) + column[None, :])
