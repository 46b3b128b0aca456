"""Lines between the mirror panels and its rims as the drawing has them, and where they cross."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: Fewest corners that hold a photo's pose with some to spare.
_FEWEST = 6


@dataclass(frozen=True, slots=True)
class PanelLine:
    """A gap between two panels, or a rim, from one corner to the next.

    axis: 0 for a line of constant x, 1 for one of constant y.
    number: Which of the edges of that axis.
    cell: Between which two edges of the other axis it runs.
    is_rim: Whether the mirror ends there.
    """

    axis: int
    number: int
    cell: int
    is_rim: bool

    @property
    def ends(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Numbers of the edges in x and in y at both its corners."""
        first, last = (self.number, self.cell), (self.number, self.cell + 1)
        return (first, last) if self.axis == 0 else (first[::-1], last[::-1])


@dataclass(frozen=True, eq=False)
class PanelLattice:
    """The panels' edges on the design surface.

    collector: The drawing.
    mounting_sigma_m: How far each panel as a whole lies off its place, along the mirror and along the trough, 1 sigma
        [m].
    corner_sigma_m: How far each of its corners is off besides, in any direction: size, turn and tilt, 1 sigma [m].
    alike_sigma_m: How far corners of one x are off in height together, along the whole trough, 1 sigma [m].
    InputError: Too few lines cross: gaps of no width cannot be seen.
    """

    collector: Collector
    mounting_sigma_m: float
    corner_sigma_m: float
    alike_sigma_m: float = 0.0

    def __post_init__(self) -> None:
        if len(self.corners) < _FEWEST:
            raise InputError(
                f"corners: the drawing has {len(self.corners)} places where rims and visible gaps cross, {_FEWEST} are "
                "needed; state panel_edges_x_m, panel_edges_y_m and panel_gap_mm of the collector, or mark targets"
            )

    @property
    def edges_m(self) -> tuple[FloatArray, FloatArray]:
        """Edges of the panels in x and in y [m]."""
        return self.collector.panel_edges_x_m, self.collector.panel_edges_y_m

    @cached_property
    def lines(self) -> tuple[PanelLine, ...]:
        """All lines that can be seen."""
        found = []
        for axis in (0, 1):
            own, other = self.edges_m[axis], self.edges_m[1 - axis]
            for number in range(own.size):
                is_rim = number in (0, own.size - 1)
                if is_rim or self.collector.panel_gap_m > 0:
                    found += [PanelLine(axis, number, cell, is_rim) for cell in range(other.size - 1)]
        return tuple(found)

    @property
    def along_trough(self) -> tuple[PanelLine, ...]:
        """Lines of constant x, which a pass across the trough sees from different sides."""
        return tuple(line for line in self.lines if line.axis == 0)

    @cached_property
    def corners(self) -> tuple[tuple[int, int], ...]:
        """Numbers of the edges in x and in y that cross in each corner."""
        seen = [{line.number for line in self.lines if line.axis == axis} for axis in (0, 1)]
        return tuple((i, j) for i in sorted(seen[0]) for j in sorted(seen[1]))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each corner."""
        return tuple(f"corner-{i}-{j}" for i, j in self.corners)

    @cached_property
    def points_m(self) -> FloatArray:
        """The corners as designed, shape (n, 3) [m]."""
        i, j = np.array(self.corners).T
        return self.on_surface(self.edges_m[0][i], self.edges_m[1][j])

    def on_surface(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return points of the design's surface, shape (n, 3) [m].

        Shapes: x_m (n,), y_m (n,).
        """
        return np.stack([x_m, y_m, x_m**2 / (4 * self.collector.focal_length_m)], axis=-1)

    def along(self, line: PanelLine, share: FloatArray) -> FloatArray:
        """Return points of a line, shape (n, 3) [m].

        share (n,): 0 at its first corner to 1 at its last.
        """
        own, other = self.edges_m[line.axis][line.number], self.edges_m[1 - line.axis]
        run = other[line.cell] + share * (other[line.cell + 1] - other[line.cell])
        fixed = np.full(run.shape, own)
        return self.on_surface(fixed, run) if line.axis == 0 else self.on_surface(run, fixed)

    def on_lines(self, lines: Sequence[PanelLine], which: IntArray, share: FloatArray) -> FloatArray:
        """Return points of several lines, shape (..., 3) [m].

        Shapes: share (...).
        which (...): Number of the line of each point.
        """
        own = np.array([self.edges_m[line.axis][line.number] for line in lines])[which]
        cells = np.array([self.edges_m[1 - line.axis][line.cell : line.cell + 2] for line in lines])
        run = cells[which, 0] + share * (cells[which, 1] - cells[which, 0])
        is_across = np.array([line.axis == 0 for line in lines])[which]
        return self.on_surface(np.where(is_across, own, run), np.where(is_across, run, own))

    @cached_property
    def receiver(self) -> AbsorberPath:
        """Axis of the receiver that stands before some lines, as designed."""
        return AbsorberPath.designed(self.collector)

    @cached_property
    def length_m(self) -> dict[PanelLine, float]:
        """Length of each line on the surface [m]."""
        courses = {line: self.along(line, np.linspace(0, 1, 9)) for line in self.lines}
        return {line: float(np.linalg.norm(np.diff(course, axis=0), axis=1).sum()) for line, course in courses.items()}

    @cached_property
    def covariance_m2(self) -> FloatArray:
        """Joint covariance of all corners about their design places, shape (3 n, 3 n) [m^2].

        A corner is the mean of the corners of the panels that meet there. Each panel lies off its place as a whole,
        along the mirror, along the trough and, by the collector's ``panel_height_sigma_m``, across the surface; each
        of its corners is off besides. What all rows of panels share of the mirror's shape does not average out over
        the rows: as errors of each row by itself it made the sigma of a far camera's direction half of what it is.
        """
        columns, rows = (edges.size - 1 for edges in self.edges_m)
        share = np.zeros((len(self.corners), columns * rows))
        for corner, (i, j) in enumerate(self.corners):
            cells = [(a, b) for a in (i - 1, i) for b in (j - 1, j) if 0 <= a < columns and 0 <= b < rows]
            for a, b in cells:
                share[corner, b * columns + a] = 1 / len(cells)
        together = share @ share.T
        slope = self.points_m[:, 0] / (2 * self.collector.focal_length_m)
        tangent = np.stack([np.ones_like(slope), np.zeros_like(slope), slope], axis=1) / np.hypot(1, slope)[:, None]
        normal = np.stack([-tangent[:, 2], np.zeros_like(slope), tangent[:, 0]], axis=1)
        along = np.broadcast_to([0.0, 1.0, 0.0], tangent.shape)
        sigmas = (self.mounting_sigma_m, self.mounting_sigma_m, self.collector.panel_height_sigma_m)
        covariance = self.corner_sigma_m**2 * np.einsum("ij,ab->iajb", np.diag(np.diag(together)), np.eye(3))
        for sigma_m, axes in zip(sigmas, (tangent, along, normal), strict=True):
            covariance += sigma_m**2 * np.einsum("ij,ia,jb->iajb", together, axes, axes)
        of_line = np.array(self.corners)[:, 0]
        up = np.diag([0.0, 0.0, self.alike_sigma_m**2])
        covariance += np.einsum("ij,ab->iajb", of_line[:, None] == of_line, up)
        size = 3 * len(self.corners)
        return np.asarray(covariance.reshape(size, size))

    def lines_at(self, corner: tuple[int, int], axis: int) -> BoolArray:
        """Return which lines of constant x (axis 0) or y (axis 1) end in a corner, shape of `lines`."""
        return np.array([line.axis == axis and corner in line.ends for line in self.lines], dtype=np.bool_)
