"""How well the part of a mirror that was not measured is known from the part that was."""

from dataclasses import dataclass

import numpy as np

from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray, IntArray

#: Blocks along the trough whose means show how much the mirror varies: about as many as a module has panels.
_BLOCKS = 6


@dataclass(frozen=True, slots=True, eq=False)
class MissingPart:
    """Where a slope map has no values, column by column.

    column, block (m,): Column of each measured node, and its block along the trough.
    missing_share (nx,): Share of each column's aperture that was not measured.
    weight (nx,): Share of the whole aperture that the missing part of each column is.
    panel (nx,): Panel of each column.
    """

    column: IntArray
    block: IntArray
    missing_share: FloatArray
    weight: FloatArray
    panel: IntArray

    def sigma(self, values: FloatArray) -> float:
        """Return how uncertain a mean over the mirror is because the missing part was taken as its columns' rest.

        values (m,): Values at the measured nodes.
        Returns: Standard deviation of the mean over the whole mirror.

        The means of blocks of a column along the trough scatter by s. n of them were measured, and the missing part
        is as many as its length holds, at least one: its mean is known to ``s sqrt(1/n + 1/missing)``. The columns of
        a panel err alike, those of other panels do not. A column with fewer than two blocks takes the median s.
        """
        if not self.weight.any():
            return 0.0
        size = self.weight.size
        place = self.column * _BLOCKS + self.block
        count = np.bincount(place, minlength=size * _BLOCKS).reshape(size, _BLOCKS)
        total = np.bincount(place, values, size * _BLOCKS).reshape(size, _BLOCKS)
        seen = count > 0
        blocks = seen.sum(axis=1)
        means = np.where(seen, total / np.maximum(count, 1), 0.0)
        center = means.sum(axis=1) / np.maximum(blocks, 1)
        square = (np.where(seen, means - center[:, None], 0.0) ** 2).sum(axis=1)
        enough = blocks >= 2
        scatter = np.sqrt(square / np.maximum(blocks - 1, 1))
        usual = float(np.median(scatter[enough])) if enough.any() else 0.5
        scatter = np.where(enough, scatter, usual)
        missing = np.maximum(_BLOCKS * self.missing_share, 1.0)
        each = self.weight * scatter * np.sqrt(1 / np.maximum(blocks, 1) + 1 / missing)
        return float(np.sqrt((np.bincount(self.panel, each) ** 2).sum()))


def missing_part(slope_map: SlopeMap, panel_edges_x_m: FloatArray) -> MissingPart:
    """Find where a slope map has no values.

    panel_edges_x_m (n,): Edges of the mirror's panels across the trough [m].
    """
    row, column = np.nonzero(slope_map.valid)
    aperture = np.count_nonzero(slope_map.aperture, axis=0)
    missing = aperture - np.count_nonzero(slope_map.valid, axis=0)
    panel = np.searchsorted(panel_edges_x_m[1:-1], slope_map.x_m, side="right")
    return MissingPart(
        np.asarray(column, dtype=np.intp),
        np.asarray(row * _BLOCKS // slope_map.y_m.size, dtype=np.intp),
        missing / np.maximum(aperture, 1),
        missing / max(int(aperture.sum()), 1),
        np.asarray(panel, dtype=np.intp),
    )
