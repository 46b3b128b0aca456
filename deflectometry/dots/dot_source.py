"""A photo of a field of dots as a source: each dot is a sample, where the photo shows it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.dots.dot_size import shift_of_size
from deflectometry.dots.found_dots import FoundDots
from deflectometry.setup.dot_screen import DotScreen
from deflectometry.sources.display_edge import DisplayEdge
from deflectometry.sources.noise_model import NoiseModel
from deflectometry.sources.sample_grid import LatticeGrid
from deflectometry.sources.screen_map import ScreenMap
from deflectometry.sources.source import Exchange, Remedies
from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array, FloatArray, freeze

#: Share of a line of the field's dots that must be seen for the mirror to look past it: a tenth.
_LEAST_LINE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class DotSource(ShortRepr):
    """The dots of a photo with their places in the pattern.

    image (h, w): The mirror without the dots: its ground [DN].
    dots: The dots, numbered as in the table: those of each lattice, where facets show several; None before they are.
    screen: The field of dots.
    near_dots (h, w): Where a dot may be taken for an edge of the mirror, or hides it; None where nobody looked.
    """

    image: Float32Array
    dots: tuple[FoundDots, ...] | None
    screen: DotScreen
    near_dots: BoolArray | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images [px]."""
        return int(self.image.shape[1]), int(self.image.shape[0])

    def mirror_image(self) -> Float32Array:
        """Return an image in which the mirror is bright: the ground of the dots [DN]."""
        return self.image

    @property
    def remedies(self) -> Remedies:
        """What to do about slopes that contradict themselves."""
        return Remedies(
            "focus the camera on the dots, light them evenly, and measure the place of each ([screen] file)",
            "that the columns of its table run to the right and the rows upwards as a viewer sees the dots, which dot "
            "is column 0, row 0",
        )

    @property
    def mixes_edges(self) -> bool:
        """Whether a dot near an edge is measured with what is beside the mirror: the edge is taken out before."""
        return False

    def clutter(self) -> BoolArray | None:
        """Return the pixels (h, w) that show a dot with its blur."""
        return self.near_dots

    def screen_map(self, region: BoolArray) -> ScreenMap:
        """Return which dot each sample sees; the samples stand in the rows and columns of the table.

        EstimationError: The dots have no places in the pattern yet.

        The centre's covariance in the photo becomes one in the pattern through the distances of neighbouring dots.
        """
        if self.dots is None:
            raise EstimationError(
                "which dots are seen follows from the mirror's pose, and that from outline_m; give [mirror] outline_m"
            )
        # Facets may show the same dots: then each lattice has rows of its own, with an empty one below.
        blocks = len(self.dots)
        rows, columns = self._block
        places = np.full((blocks, rows, columns, 2), np.nan)
        covariance = np.full((blocks, rows, columns, 2, 2), np.nan)
        contrast = np.full((blocks, rows, columns), np.nan, dtype=np.float32)
        cut = np.zeros((blocks, rows, columns), dtype=np.bool_)
        listed = np.zeros((rows, columns), dtype=np.bool_)
        listed[: self.screen.shape[0]] = np.isfinite(self.screen.xyz_m[..., 0])
        for block, dots in enumerate(self.dots):
            column, row = dots.number[:, 0] - self.screen.first[0], self.screen.first[1] - dots.number[:, 1]
            there = (column >= 0) & (column < columns) & (row >= 0) & (row < self.screen.shape[0])
            at = block, row[there], column[there]
            places[at], covariance[at] = dots.centers_px[there], dots.covariance_px2[there]
            contrast[at], cut[at] = dots.contrast_dn[there], dots.is_cut[there]
            shapes = np.full((rows, columns, 2, 2), np.nan)
            shapes[at[1:]] = dots.outlines_px2[there]
            places[block], covariance[block] = self._middles(places[block], covariance[block], shapes, cut[block])
        measured = (np.isfinite(places[..., 0]) & listed & ~cut).reshape(-1, columns)
        bridged = np.concatenate([_bridged(one) for one in places])
        grid = LatticeGrid(bridged, blocks)
        steps = 1.0 / (columns - 1), 1.0 / (self.screen.shape[0] - 1)
        sigma_u, sigma_v = (
            k * one for k, one in zip(steps, _sigma_of_steps(bridged, np.concatenate(covariance)), strict=True)
        )
        # The empty row lies beyond the field: nothing is measured there.
        v, u = np.meshgrid(np.minimum(np.arange(rows) * steps[1], 1.0), np.arange(columns) * steps[0], indexing="ij")
        u, v = np.tile(u, (blocks, 1)), np.tile(v, (blocks, 1))
        # What is not known of a dot's own place counts as if it were seen beside it.
        own = self.screen.sigma_at(u, v)[..., :2] / self.screen.spacing_m * steps
        sigma_u, sigma_v = np.hypot(sigma_u, own[..., 0]), np.hypot(sigma_v, own[..., 1])
        flags = np.where(measured, 0, int(SampleFlag.NOT_SEEN)).astype(np.uint32)
        flags[cut.reshape(-1, columns)] = np.uint32(SampleFlag.MIRROR_EDGE)
        maps = [np.where(measured, one, np.nan) for one in (u, v, sigma_u, sigma_v)]
        noise = NoiseModel(max(1e-6, *(one.residual_dn for one in self.dots)))
        return ScreenMap(
            freeze(maps[0]),
            freeze(maps[1]),
            freeze(maps[2].astype(np.float32)),
            freeze(maps[3].astype(np.float32)),
            freeze(np.concatenate(contrast)),
            freeze(flags),
            noise,
            grid=grid,
        )

    def _middles(
        self, places_px: FloatArray, covariance_px2: FloatArray, shapes_px2: FloatArray, cut: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return where the photo shows the middles of dots of one lattice, and how sure that is.

        Shapes: places_px (rows, columns, 2), covariance_px2, shapes_px2 (rows, columns, 2, 2), cut (rows, columns).
        """
        rows = self.screen.shape[0]
        known = np.full((*places_px.shape[:2], 3), np.nan)
        known[:rows] = self.screen.xyz_m
        whole = np.where(cut[..., None], np.nan, places_px)
        shift = shift_of_size(whole, known, shapes_px2)
        known_shift = np.isfinite(shift[..., 0])
        if not known_shift.any():
            return places_px, covariance_px2
        # At the rim the mirror's curvature is not known: there a shift as usual may be.
        usual = shift[known_shift].T @ shift[known_shift] / np.count_nonzero(known_shift)
        covariance = np.where(known_shift[..., None, None], covariance_px2, covariance_px2 + usual)
        return places_px - np.nan_to_num(shift), covariance

    @property
    def _block(self) -> tuple[int, int]:
        """Rows and columns of one lattice."""
        rows, columns = self.screen.shape
        return (rows if self.dots is None or len(self.dots) == 1 else rows + 1), columns

    def display_edge(self, screen_map: ScreenMap, region: BoolArray, margin_px: float) -> DisplayEdge:
        """Say at which edges of the field the mirror shows its outermost dots; no dot is flagged, each is whole."""
        seen = (region & (screen_map.flags == 0)).reshape(-1, *self._block).any(axis=0)[: self.screen.shape[0]]
        lines = {"left": seen[:, 0], "right": seen[:, -1], "upper": seen[0], "lower": seen[-1]}
        share = _LEAST_LINE * float(np.sqrt(float(np.count_nonzero(seen))))
        names = tuple(name for name, line in lines.items() if np.count_nonzero(line) > share)
        return DisplayEdge(screen_map, names, 0)

    def exchanges(self, seen: ScreenMap) -> Iterator[Exchange]:
        """Yield what programs and people exchange: the sides of the photo. The dots are measured; no map is needed."""
        size = np.array(self.size_px) - 1.0
        for words, signs in (
            ("left and right of the photo are exchanged", (-1, 1)),
            ("top and bottom of the photo are exchanged", (1, -1)),
            ("the photo is turned by 180 deg", (-1, -1)),
        ):
            image = np.ascontiguousarray(self.image[:: signs[1], :: signs[0]])
            dots = None
            if self.dots is not None:
                dots = tuple(
                    replace(
                        one,
                        centers_px=np.where(np.array(signs) < 0, size - one.centers_px, one.centers_px),
                        covariance_px2=one.covariance_px2 * np.outer(signs, signs),
                        shapes_px2=one.outlines_px2 * np.outer(signs, signs),
                    )
                    for one in self.dots
                )
            near = self.near_dots
            if near is not None:
                near = np.ascontiguousarray(near[:: signs[1], :: signs[0]])
            yield Exchange(words, replace(self, image=image, dots=dots, near_dots=near), moves_outline=True)


def _bridged(places_px: FloatArray) -> FloatArray:
    """Put samples without a dot between their neighbours of row or column, where there are both."""
    between = np.full((2, *places_px.shape), np.nan)
    between[0, :, 1:-1] = 0.5 * (places_px[:, :-2] + places_px[:, 2:])
    between[1, 1:-1] = 0.5 * (places_px[:-2] + places_px[2:])
    count = np.isfinite(between).sum(axis=0)
    bridged = np.nansum(between, axis=0) / np.maximum(count, 1)
    gap = np.isnan(places_px) & (count > 0)
    return np.where(gap, bridged, places_px)


def _sigma_of_steps(places_px: FloatArray, covariance_px2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviations of column and row, each of shape (rows, columns).

    Shapes: places_px (rows, columns, 2), covariance_px2 (rows, columns, 2, 2).
    """
    steps = np.stack([_steps(places_px, 1), _steps(places_px, 0)], axis=-1)
    # A dot without neighbours along one of them has the usual step there.
    steps = np.where(np.isfinite(steps), steps, np.nanmedian(steps, axis=(0, 1)))
    with np.errstate(invalid="ignore", divide="ignore"):
        determinant = steps[..., 0, 0] * steps[..., 1, 1] - steps[..., 0, 1] * steps[..., 1, 0]
        inverse = np.stack(
            [
                np.stack([steps[..., 1, 1], -steps[..., 0, 1]], axis=-1),
                np.stack([-steps[..., 1, 0], steps[..., 0, 0]], axis=-1),
            ],
            axis=-2,
        )
        inverse /= determinant[..., None, None]
        own = np.einsum("...ij,...jk,...ik->...i", inverse, covariance_px2, inverse)
    return np.sqrt(own[..., 0]), np.sqrt(own[..., 1])


def _steps(places_px: FloatArray, axis: int) -> FloatArray:
    """Return how the place in the photo changes from dot to dot along an axis: over both neighbours, or one."""
    forward = np.full(places_px.shape, np.nan)
    backward = forward.copy()
    change = np.diff(places_px, axis=axis)
    forward[tuple(slice(None, -1) if k == axis else slice(None) for k in range(2))] = change
    backward[tuple(slice(1, None) if k == axis else slice(None) for k in range(2))] = change
    both = np.stack([forward, backward])
    count = np.isfinite(both).sum(axis=0)
    total = np.nansum(both, axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))
