"""What each frame has beside its fringes: an offset, a gain, a step and a shift of its own, in one adjustment.

Model of frame k of set j at a pixel: ``I = o_k + (1 + g_k) (a + b_j cos(2 pi P_j w - s_k - d_k))``, with a, b_j and the
display coordinates w = u, v of the pixel taken where the frame's shift puts them. The unknowns of the pixels are
eliminated; what is left determines o, g, d and the shift of each frame, with its covariance.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from deflectometry.frames.frame_content import agreeing_sets, fit_sets, position_from_sets, spread_of_frames
from deflectometry.fringes.phase import TURN_RAD, LightResponse
from deflectometry.setup.patterns import Axis, FringePattern
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import FloatArray, IntArray

#: Pixels that determine the parameters, and readings: 400 pixels give an offset to a twentieth of the noise.
_PIXELS, _PIXEL_FRAMES = 400, 25_600
#: Columns of a frame: offset, gain, step, shift in x and in y, contrast, periods; waves that all sets share.
_COLUMNS, _ORDERS = 7, (2, 3)
_WAVES = 2 * len(_ORDERS)
#: Rounds of the adjustment, and things found odd: a sequence with more of them has another cause.
MOST_ROUNDS, MOST_ODDITIES = 30, 12
#: Standard errors that an effect must exceed: once in 5e8 by chance.
_SIGNIFICANT = 6.0
#: Light of a frame that is usual with displays and lamps, 1 sigma: the share from which `check_exposure` names it.
_FLICKER = 0.01
#: Effect on the phase, over that of noise, from which a frame is corrected: below, sigma is right within an eighth.
_LEAST_EFFECT = 0.5
#: Scatter of readings, over the light, below which frames count as no quieter: that of 10^6 electrons, more than pixels
#: holds. What is left then is the model's own: fringes are no plane waves within a pixel.
_LEAST_NOISE = 1e-3


class OddityKind(StrEnum):
    """What can be odd about a frame or several of them."""

    OFFSET = "offset"
    GAIN = "gain"
    DRIFT = "drift"
    AMBIENT = "drift of other light"
    FLICKER = "flicker"
    STEP = "step"
    STEPS_OF_SET = "steps of a set"
    STEPS_OF_ALL = "steps of all sets"
    SCALE_OF_SET = "periods and place of a set"
    SHIFT = "shift"
    KNOCK = "knock"
    CONTRAST = "contrast"


_LIGHT = (OddityKind.OFFSET, OddityKind.GAIN, OddityKind.DRIFT, OddityKind.AMBIENT, OddityKind.FLICKER)


@dataclass(frozen=True, slots=True, eq=False)
class Oddity:
    """One thing that the frames have beside their fringes.

    frames: Frames concerned, from 0.
    value, sigma (c,): Offset [DN], gain, drift over the sequence, drift of other light [DN], gains of all frames but
        the first, step [rad], relative change of steps, shift in x and y [px], relative change of periods and place on
        the display [rad], or contrast.
    chi_square: How much the misfit falls with it.
    """

    kind: OddityKind
    frames: tuple[int, ...]
    value: FloatArray
    sigma: FloatArray
    chi_square: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameModel:
    """What the frames have beside their fringes.

    oddities: What was found, the clearest first.
    offset_dn, gain, step_rad, contrast, periods (n,), shift_px (n, 2): All of it together, for each frame; periods as a
        relative change about the middle of the display.
    """

    oddities: tuple[Oddity, ...]
    offset_dn: FloatArray
    gain: FloatArray
    step_rad: FloatArray
    shift_px: FloatArray
    contrast: FloatArray
    periods: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """Readings of some pixels and what the sets together say of them.

    light (n, m): Linear readings.
    weight (n, m): Inverse of their noise, about 1: a response is steeper in the dark.
    offset (m,): Mean light, and its gradient (2, m).
    modulation (s, m): Of each set.
    place (2, m): Display coordinates u, v, and their gradients (2, 2, m): axis, then direction in the image.
    """

    light: FloatArray
    weight: FloatArray
    offset: FloatArray
    d_offset: FloatArray
    modulation: FloatArray
    place: FloatArray
    d_place: FloatArray


def estimate_frames(
    frames: npt.NDArray[np.generic],
    pattern: FringePattern,
    noise: NoiseModel,
    *,
    response: LightResponse | None = None,
    saturation_dn: float = np.inf,
) -> FrameModel | None:
    """Find what frames have beside their fringes: the clearest first, until nothing is left that noise cannot make.

    frames (n, h, w): Frames in the order of the pattern [DN].
    noise: Noise of linear light.
    response: Makes readings linear.
    Returns: None where too few pixels show fringes with certain orders.

    Each candidate costs what its number of values costs in evidence (half the logarithm of the readings for each value;
    Schwarz 1978); it must also matter: its effect on the phase is at least half that of noise. Harmonics of the
    display, common to all sets, are estimated at the same time: a gamma is no wrong step.
    """
    pixels = _choose(frames, pattern, noise, response, saturation_dn)
    if pixels is None:
        return None
    n = pattern.n_frames
    # Next to black a response is uncertain, and with it light and contrast of frames that are dark there.
    uncertain = (*_LIGHT, OddityKind.CONTRAST) if response is not None else ()
    candidates = [one for one in _candidates(pattern) if one.kind not in uncertain]
    chosen: list[_Candidate] = []
    values: list[FloatArray] = []
    for _ in range(MOST_ROUNDS):
        found = sum((one.columns @ value for one, value in zip(chosen, values, strict=True)), np.zeros(n * _COLUMNS))
        equations = _Equations.at(pixels, pattern, found.reshape(n, _COLUMNS))
        solution = equations.solve(chosen)
        values = [value + step for value, step in zip(values, solution.changes, strict=True)]
        pixels = equations.pixels_after(solution.all_changes)
        settled = all(
            (np.abs(step) < 0.2 * sigma).all() for step, sigma in zip(solution.changes, solution.sigmas, strict=True)
        )
        better = equations.best(candidates, chosen, solution)
        if better is not None and len(chosen) < MOST_ODDITIES:
            chosen.append(better)
            values.append(np.zeros(better.columns.shape[1]))
        elif settled:
            break
    every, oddities = np.zeros(n * _COLUMNS), []
    for one, value, sigma in zip(chosen, values, solution.sigmas, strict=False):
        clear = float(((value / sigma) ** 2).sum())
        # What a later candidate explained better is nothing any more.
        if clear > _SIGNIFICANT**2:
            every += one.columns @ value
            oddities.append(Oddity(one.kind, one.frames, value, sigma, clear))
    parts = every.reshape(n, _COLUMNS).T
    return FrameModel(tuple(oddities), parts[0], parts[1], parts[2], parts[3:5].T, parts[5], parts[6])


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """Something that may be odd.

    columns (n * 7, c): What a unit of each of its values does to the frames' parameters.
    """

    kind: OddityKind
    frames: tuple[int, ...]
    columns: FloatArray


def _candidates(pattern: FringePattern) -> list[_Candidate]:
    """List what may be odd about frames, sets and the whole sequence."""
    n = pattern.n_frames
    listed = []

    def add(kind: OddityKind, frames: Iterable[int], *amounts: tuple[int, FloatArray]) -> None:
        columns = np.zeros((n, _COLUMNS, len(amounts)))
        for number, (column, amount) in enumerate(amounts):
            columns[:, column, number] = amount
        listed.append(_Candidate(kind, tuple(frames), columns.reshape(n * _COLUMNS, -1)))

    single = (OddityKind.OFFSET, OddityKind.GAIN, OddityKind.STEP, OddityKind.CONTRAST)
    for k in range(n):
        one = np.eye(n)[k]
        for kind, column in zip(single, (0, 1, 2, 5), strict=True):
            add(kind, (k,), (column, one))
        add(OddityKind.SHIFT, (k,), (3, one), (4, one))
        if 2 <= k <= n - 2:
            after = (np.arange(n) >= k).astype(np.float64)
            add(OddityKind.KNOCK, range(k, n), (3, after), (4, after))
    add(OddityKind.DRIFT, range(n), (1, np.linspace(0.0, 1.0, n)))
    # Light of the room rises or falls for all pixels alike, whatever the display shows.
    add(OddityKind.AMBIENT, range(n), (0, np.linspace(0.0, 1.0, n)))
    # A gain of all frames together is the pixels' own light.
    add(OddityKind.FLICKER, range(n), *((1, one) for one in np.eye(n)[1:] - 1.0 / n))
    planned = np.concatenate([one.steps_rad for one in pattern.sets])
    add(OddityKind.STEPS_OF_ALL, range(n), (2, planned))
    for where in pattern.frame_slices:
        inside = np.zeros(n)
        inside[where] = 1.0
        frames = range(where.start, where.stop)
        add(OddityKind.STEPS_OF_SET, frames, (2, inside * planned))
        # Never the place alone: of a set that stands elsewhere nobody knows that its periods are as stated, and over
        # the part of the display that a mirror shows a wrong scale is nine tenths a wrong place.
        add(OddityKind.SCALE_OF_SET, frames, (6, inside), (2, inside))
    return listed


def _choose(
    frames: npt.NDArray[np.generic],
    pattern: FringePattern,
    noise: NoiseModel,
    response: LightResponse | None,
    saturation_dn: float,
) -> _Pixels | None:
    """Pick pixels whose neighbours show fringes too, and fit them."""
    n, height, width = frames.shape
    most = min(_PIXELS, _PIXEL_FRAMES // n)
    index = _lit(frames, 3 * most)
    row, column = np.divmod(index, width)
    inner = (row > 0) & (row < height - 1) & (column > 0) & (column < width - 1)
    row, column = row[inner], column[inner]
    around = [(0, 0), (0, -1), (0, 1), (-1, 0), (1, 0)]
    readings = np.stack([frames[:, row + down, column + right] for down, right in around], axis=1).astype(np.float64)
    light = readings if response is None else response.linearise(readings)
    flat = light.reshape(n, -1)
    fit = fit_sets(flat, pattern)
    good = (readings.max(axis=(0, 1)) < saturation_dn) & np.isfinite(readings).all(axis=(0, 1))
    place = []
    for axis in Axis:
        group = agreeing_sets(fit, pattern, axis, noise).sets
        position = position_from_sets(fit, pattern, group, noise)
        good &= (position.log_odds.reshape(5, -1) > 6.9).all(axis=0)
        place.append(position.fraction.reshape(5, -1))
    modulation = fit.modulation.reshape(len(pattern.sets), 5, -1)
    offset = np.median(fit.offset, axis=0).reshape(5, -1)
    # The edge of the mirror is no part of it: there the modulation falls within a pixel.
    strength = modulation.mean(axis=0)
    good &= np.ptp(strength, axis=0) < 0.1 * strength[0]
    chosen = np.flatnonzero(good)
    if chosen.size < 100:
        return None
    chosen = chosen[:: max(1, -(-chosen.size // most))]
    places = np.stack(place)[..., chosen]
    weight = np.ones((n, chosen.size))
    if response is not None:
        slope = response.slope(readings[:, 0, chosen])
        usual = float(np.median(slope))
        # Next to black a response is a guess: a reading counts at most twice, at least a twentieth.
        weight = usual / np.clip(slope, 0.5 * usual, 20 * usual)
    return _Pixels(
        light[:, 0, chosen],
        weight,
        offset[0, chosen],
        _gradient(offset[:, chosen]),
        modulation[:, 0, chosen],
        places[:, 0],
        np.stack([_gradient(one) for one in places]),
    )


def _lit(frames: npt.NDArray[np.generic], most: int) -> IntArray:
    """Return the flat indices of pixels that vary from frame to frame, spread over the image."""
    height, width = frames.shape[1:]
    stride = max(1, int(np.sqrt(height * width / (10 * most))))
    thin = frames[:, ::stride, ::stride].astype(np.float32)
    spread = spread_of_frames(np.nan_to_num(thin).reshape(len(thin), -1)).reshape(thin.shape[1:])
    rows, columns = np.nonzero(spread > 0.3 * np.quantile(spread, 0.99))
    kept = slice(None, None, max(1, rows.size // most))
    return np.asarray(rows[kept] * stride * width + columns[kept] * stride)


def _gradient(values: FloatArray) -> FloatArray:
    """Return the derivatives in x and y from a pixel and its left, right, upper and lower neighbour, shape (2, m)."""
    return np.stack([0.5 * (values[2] - values[1]), 0.5 * (values[4] - values[3])])


class _Solution(NamedTuple):
    """Changes of the chosen candidates with their sigmas, and all parameters' changes (frames, then harmonics)."""

    changes: list[FloatArray]
    sigmas: list[FloatArray]
    all_changes: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations of the frames' parameters and the harmonics; the pixels' own unknowns are eliminated.

    normal (n * 7 + 4, n * 7 + 4), right (n * 7 + 4,): Of readings with the scatter `scale_dn`.
    to_phase (n, 6): Effect of a unit of each parameter on the phase, over that of noise.
    """

    pixels: _Pixels
    left: FloatArray
    basis: FloatArray
    triangle: FloatArray
    columns: FloatArray
    waves: FloatArray
    normal: FloatArray
    right: FloatArray
    scale_dn: float
    to_phase: FloatArray

    @classmethod
    def at(cls, pixels: _Pixels, pattern: FringePattern, found: FloatArray) -> "_Equations":
        """Linearise at the parameters found so far, shape (n, 7)."""
        n, m = pixels.light.shape
        sets = len(pattern.sets)
        model = np.empty((n, m))
        own = np.zeros((m, n, 1 + sets + 2))
        columns = np.zeros((_COLUMNS, n, m))
        waves = np.zeros((_WAVES, n, m))
        for j, (one, where) in enumerate(zip(pattern.sets, pattern.frame_slices, strict=True)):
            axis = 0 if one.axis is Axis.X else 1
            offset, gain, step, shift_x, shift_y, contrast, scale = found[where].T[:, :, None]
            turn = TURN_RAD * one.periods
            by_x, by_y = turn * pixels.d_place[axis]
            # A scale of the periods about the middle of the display, so that it is no offset as well.
            scaled = turn * (pixels.place[axis] - 0.5)
            angle = turn * pixels.place[axis] + by_x * shift_x + by_y * shift_y + scale * scaled
            angle = angle - one.steps_rad[:, None] - step
            b = pixels.modulation[j] * (1 + contrast)
            base = pixels.offset + pixels.d_offset[0] * shift_x + pixels.d_offset[1] * shift_y
            cosine, sine = b * np.cos(angle), b * np.sin(angle)
            model[where] = offset + (1 + gain) * (base + cosine)
            own[:, where, 0] = np.broadcast_to(1 + gain, sine.shape).T
            own[:, where, 1 + j] = ((1 + gain) * cosine / pixels.modulation[j]).T
            own[:, where, 1 + sets + axis] = -((1 + gain) * turn * sine).T
            columns[:, where] = np.stack(
                [
                    np.ones_like(sine),
                    base + cosine,
                    (1 + gain) * sine,
                    (1 + gain) * (pixels.d_offset[0] - by_x * sine),
                    (1 + gain) * (pixels.d_offset[1] - by_y * sine),
                    (1 + gain) * pixels.modulation[j] * np.cos(angle),
                    -(1 + gain) * scaled * sine,
                ]
            )
            waves[:, where] = [b * wave(order * angle) for order in _ORDERS for wave in (np.cos, np.sin)]
        left = (pixels.light - model) * pixels.weight
        own *= pixels.weight.T[:, :, None]
        columns *= pixels.weight
        waves *= pixels.weight
        basis, triangle = np.linalg.qr(own)
        transposed = basis.swapaxes(1, 2)
        freedom = n - own.shape[2]
        kept = left.T - (basis @ (transposed @ left.T[:, :, None]))[:, :, 0]
        size = np.sqrt((kept**2).sum(axis=1) / freedom)
        # A pixel on a stain or a moving shadow counts for less: Cauchy's weight about the usual pixel.
        root = 1.0 / np.sqrt(1.0 + (size / (2.5 * np.median(size))) ** 2)
        by_frame = columns.transpose(2, 1, 0) * root[:, None, None]
        by_wave = waves.transpose(2, 1, 0) * root[:, None, None]
        # B' (1 - Q Q') B over all pixels: the first part couples no frames, the second is one product of matrices.
        inside = (transposed[:, :, :, None] * by_frame[:, None]).reshape(m * own.shape[2], n * _COLUMNS)
        inside_waves = (transposed @ by_wave).reshape(m * own.shape[2], -1)
        normal = -(inside.T @ inside)
        diagonal = np.einsum("pkc,pkd->kcd", by_frame, by_frame)
        for k in range(n):
            place = slice(k * _COLUMNS, (k + 1) * _COLUMNS)
            normal[place, place] += diagonal[k]
        cross = np.einsum("pkc,pkh->kch", by_frame, by_wave).reshape(n * _COLUMNS, -1) - inside.T @ inside_waves
        among = np.einsum("pkg,pkh->gh", by_wave, by_wave) - inside_waves.T @ inside_waves
        weighted = kept * root[:, None]
        rights = np.concatenate(
            [np.einsum("pkc,pk->kc", by_frame, weighted).ravel(), np.einsum("pkh,pk->h", by_wave, weighted)]
        )
        least = max(_LEAST_NOISE * float(np.median(pixels.offset)), 1e-9)
        scale = max(float(robust_scale(kept)) * np.sqrt(n / freedom), least)
        whole = np.block([[normal, cross], [cross.T, among]]) / scale**2
        to_phase = _effects(pixels, pattern, scale)
        return cls(pixels, left, basis, triangle, columns, waves, whole, rights / scale**2, scale, to_phase)

    def solve(self, chosen: Sequence[_Candidate]) -> _Solution:
        """Solve for the chosen candidates and the harmonics."""
        columns = self._with_harmonics(chosen)
        # Harmonics that the steps cannot show stay zero: a third of the modulation is the most there can be.
        weak = np.zeros(columns.shape[1])
        weak[-_WAVES:] = 9.0
        covariance = np.linalg.pinv(columns.T @ self.normal @ columns + np.diag(weak), rcond=1e-12, hermitian=True)
        solved = covariance @ (columns.T @ self.right)
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        ends = np.cumsum([one.columns.shape[1] for one in chosen])
        return _Solution(
            np.split(solved[:-_WAVES], ends[:-1]) if len(chosen) else [],
            np.split(sigma[:-_WAVES], ends[:-1]) if len(chosen) else [],
            columns @ solved,
        )

    def _with_harmonics(self, chosen: Sequence[_Candidate]) -> FloatArray:
        size = len(self.right)
        frames = [np.vstack([one.columns, np.zeros((_WAVES, one.columns.shape[1]))]) for one in chosen]
        return np.hstack([*frames, np.eye(size)[:, -_WAVES:]])

    def best(
        self, candidates: Sequence[_Candidate], chosen: Sequence[_Candidate], solution: _Solution
    ) -> _Candidate | None:
        """Return the candidate with the most evidence, given those that were chosen; None where none matters.

        As long as anything with evidence moves the phase, the clearest comes next, whether it does or not: periods of a
        coarse set that are a little off are explained by those of the finest one nearly as well, with a larger effect.
        """
        active = self._with_harmonics(chosen)
        frames = len(self.right) - _WAVES
        of_light = self._given(active, np.zeros(active.shape[1]), solution)
        # Small flicker of every frame is no motion and no wrong step: for these, it is an unknown with a prior.
        light = np.zeros((len(self.right), len(self.left)))
        light[np.arange(0, frames, _COLUMNS), np.arange(len(self.left))] = 1.0
        usual = _FLICKER * float(np.median(self.pixels.offset))
        priors = np.concatenate([np.zeros(active.shape[1]), np.full(len(self.left), usual**-2)])
        of_rest = self._given(np.hstack([active, light]), priors, solution)
        per_value = np.log(self.left.size)
        best, most, matters = None, 0.0, False
        for one in candidates:
            if any(one is other for other in chosen):
                continue
            rest, score = of_light if one.kind in _LIGHT else of_rest
            information, along = one.columns.T @ rest @ one.columns, one.columns.T @ score
            own = one.columns.T @ self.normal[:frames, :frames] @ one.columns
            # What the chosen ones explain to all but a millionth is no candidate any more.
            if (np.diag(information) < 1e-6 * np.diag(own)).any():
                continue
            # Flicker of all frames holds a drift that was chosen before: what is explained already counts for nothing.
            value = np.linalg.lstsq(information, along, rcond=1e-12)[0]
            by_frame = np.abs((one.columns @ value).reshape(-1, _COLUMNS) * self.to_phase).sum(axis=1)
            # Frames that flicker each for itself add up like noise, but no mean over pixels takes that away.
            effect = np.linalg.norm(by_frame) if one.kind is OddityKind.FLICKER else by_frame.max()
            gain = float(value @ along) - per_value * len(value) - _SIGNIFICANT**2
            matters = matters or bool(gain > 0 and effect > _LEAST_EFFECT)
            if gain > most:
                best, most = one, gain
        return best if matters else None

    def _given(self, active: FloatArray, priors: FloatArray, solution: _Solution) -> tuple[FloatArray, FloatArray]:
        """Return normal matrix and right side of the frames' parameters with other unknowns eliminated."""
        frames = len(self.right) - _WAVES
        coupled = self.normal @ active
        inner = coupled @ np.linalg.pinv(active.T @ coupled + np.diag(priors), rcond=1e-12, hermitian=True)
        score = self.right - self.normal @ solution.all_changes
        return (self.normal - inner @ coupled.T)[:frames, :frames], (score - inner @ (active.T @ score))[:frames]

    def pixels_after(self, changes: FloatArray) -> _Pixels:
        """Return the pixels' own unknowns after the frames' parameters have changed."""
        n = len(self.left)
        frames = changes[:-_WAVES].reshape(n, _COLUMNS)
        explained = np.einsum("ckp,kc->pk", self.columns, frames) + self.waves.T @ changes[-_WAVES:]
        missing = (self.left.T - explained)[:, :, None]
        own = np.linalg.solve(self.triangle, self.basis.swapaxes(1, 2) @ missing)[:, :, 0].T
        pixels, sets = self.pixels, len(own) - 3
        usual = float(np.median(pixels.modulation))
        return replace(
            pixels,
            offset=pixels.offset + own[0],
            modulation=np.maximum(pixels.modulation + own[1 : 1 + sets], 1e-3 * usual),
            place=pixels.place + own[1 + sets :],
        )


def _effects(pixels: _Pixels, pattern: FringePattern, scale_dn: float) -> FloatArray:
    """Return what a unit of each parameter does to the position on the display, over what noise does, shape (n, 7).

    A set counts for its share of the position, or for the order of the next finer one: a tenth of a turn of that counts
    as much as the least effect that is looked for.
    """
    effects = np.zeros((pattern.n_frames, _COLUMNS))
    usual = [float(np.median(one)) for one in pixels.modulation]
    information = [(b * one.periods) ** 2 * one.n_frames for b, one in zip(usual, pattern.sets, strict=True)]
    for j, (one, where) in enumerate(zip(pattern.sets, pattern.frame_slices, strict=True)):
        axis = 0 if one.axis is Axis.X else 1
        b, frames = float(np.median(pixels.modulation[j])), one.n_frames
        light = 1.0 / (scale_dn * np.sqrt(frames))
        turn = b / (scale_dn * np.sqrt(2.0 * frames))
        per_px = TURN_RAD * one.periods * np.median(np.abs(pixels.d_place[axis]), axis=1)
        same = [i for i, other in enumerate(pattern.sets) if other.axis is one.axis]
        share = np.sqrt(information[j] / sum(information[i] for i in same))
        finer = min((pattern.sets[i].periods for i in same if pattern.sets[i].periods > one.periods), default=0.0)
        order = _LEAST_EFFECT * finer / one.periods / (0.1 * TURN_RAD) / turn
        across = TURN_RAD * one.periods * float(np.std(pixels.place[axis]))
        effects[where] = [light, light * float(np.median(pixels.offset)), turn, *(per_px * turn), turn, across * turn]
        effects[where] *= max(share, order)
    return effects
