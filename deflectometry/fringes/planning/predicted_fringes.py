"""Fringes that a mirror will show: the point of the screen at each pixel, as well as the phases will know it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deflectometry.fringes.observation import FRINGE_REMEDIES
from deflectometry.fringes.phase import TURN_RAD
from deflectometry.fringes.screen_map import measure_screen_map
from deflectometry.planning.predicted_sight import FacetSight
from deflectometry.setup.patterns import Axis, FringePattern, design_matrix
from deflectometry.sources.display_edge import DisplayEdge, flag_display_edge
from deflectometry.sources.noise_model import NoiseModel
from deflectometry.sources.screen_map import ScreenMap
from deflectometry.sources.source import Exchange, Remedies
from heliogauge.errors import EstimationError
from heliogauge.flags import FLAG_TEXTS, SampleFlag, count_flags
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: Pixels whose phases are measured to know how well all are: their median sigma is known to a per cent.
_PIXELS = 45
#: More pixels without an answer than this, and the pattern does not determine them.
_MOST_REJECTED = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class PredictedFringes:
    """A source whose pixels see what a mirror of design shape shows.

    image (h, w): How the mirror stands out [DN].
    u, v (h, w): Point of the screen that each pixel will see.
    sigma (2,): Standard deviations of u and v.
    contrast_dn: Amplitude of the fringes [DN].
    """

    image: Float32Array
    u: FloatArray
    v: FloatArray
    sigma: FloatArray
    contrast_dn: float
    noise: NoiseModel

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images [px]."""
        return int(self.image.shape[1]), int(self.image.shape[0])

    @property
    def remedies(self) -> Remedies:
        """What to do about slopes that contradict themselves."""
        return FRINGE_REMEDIES

    @property
    def mixes_edges(self) -> bool:
        """Whether a sample near an edge shows what is beside the mirror: a pixel does."""
        return True

    def mirror_image(self) -> Float32Array:
        """Return an image in which the mirror is bright [DN]."""
        return self.image

    def clutter(self) -> None:
        """Fringes are averaged out: nothing in the mirror looks like its edge."""

    def screen_map(self, region: BoolArray) -> ScreenMap:
        """Return the display point that each pixel of a region will see."""
        seen = region & (self.u >= 0) & (self.u <= 1) & (self.v >= 0) & (self.v <= 1)
        flags = np.where(seen, 0, np.where(region, SampleFlag.OFF_SCREEN, SampleFlag.OUTSIDE_MIRROR)).astype(np.uint32)
        values = [
            np.where(seen, one, np.nan).astype(np.float32) for one in (self.u, self.v, self.sigma[0], self.sigma[1])
        ]
        contrast = np.full(region.shape, self.contrast_dn, dtype=np.float32)
        return ScreenMap(values[0], values[1], values[2], values[3], contrast, flags, self.noise)

    def display_edge(self, screen_map: ScreenMap, region: BoolArray, margin_px: float) -> DisplayEdge:
        """Flag pixels that see the edge of the display."""
        return flag_display_edge(screen_map, region, margin_px)

    def exchanges(self, seen: ScreenMap) -> Iterator[Exchange]:
        """Yield nothing: a prediction has exchanged nothing."""
        yield from ()


def screen_points(sights: Sequence[FacetSight], shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Put what the facets show into one image: u and v (h, w), NaN where no facet is near."""
    u, v = np.full(shape, np.nan), np.full(shape, np.nan)
    # First all of the boxes: pixels beside an outline that is found a little off it have a value. Then the facets.
    for whole in (True, False):
        for one in sights:
            at = (one.rows, one.columns)
            own = np.isfinite(one.u) & (whole | one.inside)
            u[at][own], v[at][own] = one.u[own], one.v[own]
    return u, v


def sigma_of_points(
    sights: Sequence[FacetSight],
    pattern: FringePattern,
    contrast_dn: float,
    noise: NoiseModel,
    blur_px: float,
    *,
    counted: bool,
) -> FloatArray:
    """Return how well u and v will be known, shape (2,): phases of some of the pixels are measured as all will be.

    counted: Orders will be counted from a known point, and are not searched.
    EstimationError: The pattern does not determine the points at this contrast and noise.
    """
    chosen = [one.inside & one.on_screen for one in sights]
    points = np.concatenate(
        [np.stack([one.u[here], one.v[here]]) for one, here in zip(sights, chosen, strict=True)], axis=1
    )
    some = points[:, np.linspace(0, points.shape[1] - 1, _PIXELS**2).astype(np.intp)].reshape(2, _PIXELS, _PIXELS)
    rng = np.random.default_rng(0)
    frames = []
    for one in pattern.sets:
        place = some[0 if one.axis is Axis.X else 1]
        amplitude = contrast_dn * float(np.prod(_weakened(sights, chosen, one.axis, one.periods, blur_px)))
        phase = TURN_RAD * one.periods * place
        wave = np.stack(
            [np.ones_like(phase), amplitude / contrast_dn * np.cos(phase), amplitude / contrast_dn * np.sin(phase)]
        )
        light = contrast_dn * np.tensordot(design_matrix(one.steps_rad), wave, axes=1)
        frames.append(light + np.sqrt(noise.variance(light)) * rng.standard_normal(light.shape))
    known = {axis: some[number] for number, axis in enumerate((Axis.X, Axis.Y))} if counted else None
    found = measure_screen_map(np.concatenate(frames).astype(np.float32), pattern, noise=noise, counted=known)
    rejected = count_flags(found.flags, np.ones(found.flags.shape, dtype=np.bool_))
    good = found.flags == 0
    if np.count_nonzero(~good) > _MOST_REJECTED * good.size:
        reasons = ", ".join(f"{FLAG_TEXTS[flag]} ({count / good.size:.0%})" for flag, count in rejected.items())
        raise EstimationError(
            f"the pattern does not determine the points of the screen with {contrast_dn:g} DN of contrast and "
            f"{noise.sigma_read_dn:g} DN of noise: {reasons}; add fringes of fewer periods, or take more frames"
        )
    return np.array([float(np.median(one[good])) for one in (found.sigma_u, found.sigma_v)])


def _weakened(
    sights: Sequence[FacetSight], chosen: Sequence[BoolArray], axis: Axis, periods: float, blur_px: float
) -> FloatArray:
    """Return how much blur, and the pixel's area along rows and columns, leave of fringes, shape (3,)."""
    turns = []
    for direction in (1, 0):
        steps = [
            np.abs(np.diff(one.u if axis is Axis.X else one.v, axis=direction)).ravel()[
                (here[:, 1:] & here[:, :-1] if direction else here[1:] & here[:-1]).ravel()
            ]
            for one, here in zip(sights, chosen, strict=True)
        ]
        turns.append(periods * float(np.median(np.concatenate(steps))))
    square = (TURN_RAD * blur_px) ** 2 * (turns[0] ** 2 + turns[1] ** 2)
    return np.array([np.exp(-0.5 * square), abs(np.sinc(turns[0])), abs(np.sinc(turns[1]))])
