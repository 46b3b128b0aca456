"""The light of many beams on one target, on one grid, in two bytes a pixel: 30 kB a beam."""

import cv2
import numpy as np
import numpy.typing as npt

from calibration.beam.light.beam_size import LightPicture
from heliogauge.validate import FloatArray

__all__ = ["FluxStore"]

#: Pixels on the longer side: beams are tens of them wide.
_LONGEST_PX = 128


class FluxStore:
    """Takes the light of beams on one target and gives it back as one array.

    corners_m (4, 2): The target's corners: the grid covers them [m].
    """

    def __init__(self, corners_m: FloatArray) -> None:
        (left, low), (right, high) = corners_m.min(axis=0), corners_m.max(axis=0)
        pixel = max(right - left, high - low) / _LONGEST_PX
        columns, rows = max(2, round((right - left) / pixel)), max(2, round((high - low) / pixel))
        self.x_m: FloatArray = left + (np.arange(columns) + 0.5) * ((right - left) / columns)
        #: Rows ascend, as axes of maps do.
        self.y_m: FloatArray = low + (np.arange(rows) + 0.5) * ((high - low) / rows)
        self.rows: list[int] = []
        #: Pixels of the photo that a node of each beam is the mean of.
        self.averaged: list[int] = []
        self._values: list[npt.NDArray[np.int16]] = []
        self._steps_dn: list[float] = []

    def add(self, row: int, light: LightPicture) -> None:
        """Add the light of one beam.

        row: Which photo it is.
        light: Its light.
        """
        column = (self.x_m - light.x_m[0]) / (light.x_m[1] - light.x_m[0])
        line = (self.y_m - light.y_m[0]) / (light.y_m[1] - light.y_m[0])
        steps = [float(np.ptp(one)) / (one.size - 1) for one in (column, line)]
        values = np.asarray(light.values_dn, dtype=np.float32)
        wide, high = (max(1, round(one)) if max(steps) > 1.2 else 1 for one in steps)
        if wide * high > 1:
            # Averages over what a node stands for, so that flux is kept where the grid is coarser than the photo.
            values = np.asarray(cv2.blur(values, (wide, high)), dtype=np.float32)
            # The mean of an even number of pixels stands half a pixel beside the one that it is kept at.
            column, line = (axis + 0.5 * (1 - count % 2) for axis, count in ((column, wide), (line, high)))
        self.averaged.append(wide * high)
        maps = np.meshgrid(column.astype(np.float32), line.astype(np.float32))
        sampled = cv2.remap(values, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        # Steps of 1/32767 of the largest value: a thousandth of what eight bits resolve.
        step = max(float(np.abs(sampled).max()), 1e-12) / 32767
        self._values.append(np.rint(sampled / step).astype(np.int16))
        self._steps_dn.append(step)
        self.rows.append(row)

    @property
    def values_dn(self) -> npt.NDArray[np.float32]:
        """The light of all beams, shape (n, ny, nx) [DN]."""
        if not self.rows:
            return np.zeros((0, self.y_m.size, self.x_m.size), dtype=np.float32)
        steps = np.array(self._steps_dn, dtype=np.float32)
        return np.stack(self._values) * steps[:, None, None]
