"""Ground without any targets: a print of random grey, for photographs whose features are natural ones."""

from dataclasses import dataclass

import cv2
import numpy as np

from data_synth.optics.coverage import Footprint, strip_coverage
from heliogauge.errors import InputError
from heliogauge.validate import Float32Array, float_array, positive


@dataclass(frozen=True, slots=True, eq=False)
class TexturePrint:
    """Shares of ink on a grid, linear in between.

    shares (h, w): Shares of ink, 0 to 1, rows from the top.
    pitch_m: Distance of neighbours on the grid [m].
    InputError: Shares beyond 0 to 1, or a grid of fewer than two rows or columns.
    """

    shares: Float32Array
    pitch_m: float

    def __post_init__(self) -> None:
        shares = float_array("texture shares", self.shares, (None, None))
        if min(shares.shape) < 2 or shares.min() < 0 or shares.max() > 1:
            raise InputError("texture: two rows and columns or more of shares from 0 to 1 are needed")
        positive("texture pitch_m", self.pitch_m, "metres")
        table = shares.astype(np.float32)
        table.setflags(write=False)
        object.__setattr__(self, "shares", table)

    @property
    def half_size_m(self) -> tuple[float, float]:
        """Half width and half height of the paper [m]."""
        rows, columns = self.shares.shape
        return 0.5 * (columns - 1) * self.pitch_m, 0.5 * (rows - 1) * self.pitch_m

    @property
    def bends_m(self) -> float:
        """Infinite: there are no sharp edges [m]."""
        return float("inf")

    @property
    def points_m(self) -> dict[str, tuple[float, float]]:
        """Empty: no point of it has a name [m]."""
        return {}

    def ink(self, x_m: Float32Array, y_m: Float32Array, cell: Footprint) -> Float32Array:
        """Return the share of ink in the middle of each cell, shape (h, w); between cells it changes linearly."""
        wide, high = self.half_size_m
        # Lines of sight that miss the sheet are kilometres away.
        column = np.clip((x_m + wide) / self.pitch_m, -1, self.shares.shape[1]).astype(np.float32)
        row = np.clip((high - y_m) / self.pitch_m, -1, self.shares.shape[0]).astype(np.float32)
        left, top = np.floor(column), np.floor(row)
        across, down = np.clip(column - left, 0, 1), np.clip(row - top, 0, 1)
        i = np.clip(top.astype(np.intp), 0, self.shares.shape[0] - 2)
        j = np.clip(left.astype(np.intp), 0, self.shares.shape[1] - 2)
        upper = self.shares[i, j] * (1 - across) + self.shares[i, j + 1] * across
        lower = self.shares[i + 1, j] * (1 - across) + self.shares[i + 1, j + 1] * across
        inside = strip_coverage(x_m, (-wide, wide), True, cell) * strip_coverage(y_m, (-high, high), False, cell)
        return np.asarray((upper * (1 - down) + lower * down) * inside, dtype=np.float32)


def random_texture(
    size_m: tuple[float, float], pitch_m: float, rng: np.random.Generator, *, coarsest: float = 16.0
) -> TexturePrint:
    """Draw a texture whose spots have all sizes, as gravel and lichen have.

    size_m: Width and height [m].
    pitch_m: Distance of neighbours on the grid; the finest spots are about three of it wide [m].
    coarsest: Standard deviation of the largest spots, in pitches.
    """
    rows, columns = (round(side / pitch_m) + 1 for side in size_m[::-1])
    total = np.zeros((rows, columns))
    sigma = 1.0
    while sigma <= coarsest:
        noise = cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), sigma)
        total += noise / noise.std()
        sigma *= 2
    total = (total - total.mean()) / total.std()
    return TexturePrint(np.clip(0.5 + 0.22 * total, 0, 1).astype(np.float32), pitch_m)
