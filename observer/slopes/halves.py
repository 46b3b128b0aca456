"""Every second photo of a flight against the others: whether two independent halves say the same slopes.

Both halves see one mirror, one tube and one list of targets. So the question is put to the adjustment that is there:
beside the slopes of the mirror it finds by how much those that one half says are larger than those of the other, as a
mean and a bend of each panel. Slopes, tube, dimensions and what poses have in common through the targets are the same
unknowns for both halves and cancel; what is left is what differs from photo to photo, and its covariance is that of the
difference. What all photos have in common (lens, list of targets, dimensions, glass) moves both alike and is not seen.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray
from observer.slopes.common_elimination import Beside
from observer.slopes.pose_modes import MODES_PER_PHOTO
from observer.slopes.row_spline import TouchingLines
from observer.trough.collector import Collector

#: No panel differs by as much between two halves [rad].
PRIOR_RAD = 1e-2
#: What is known to this share of it is known from the photos: the prior pulls it by a hundredth.
_KNOWN_SHARE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Halves:
    """By how much the slopes of one half of the photos are larger than those of the other.

    difference_rad (k,): Means of dz/dx over panels and their changes across, in units that add in squares to the mean
        square over a panel; those that the photos determine [rad].
    covariance (k, k): Its covariance, whatever both halves have in common left out [rad^2].
    n_panels: Panels over which they are.
    """

    difference_rad: FloatArray
    covariance: FloatArray
    n_panels: int

    @property
    def rms_rad(self) -> float:
        """RMS difference over the panels [rad]."""
        return float(np.sqrt(np.sum(self.difference_rad**2) / max(self.n_panels, 1)))

    @property
    def expected_rad(self) -> float:
        """What noise and poses let expect of it [rad]."""
        return float(np.sqrt(np.trace(self.covariance) / max(self.n_panels, 1)))

    @property
    def chi_square(self) -> float:
        """Square of the differences over their sigmas, whitened together, for each of them; 1 is expected."""
        whole = self.difference_rad @ np.linalg.solve(self.covariance, self.difference_rad)
        return float(whole) / max(self.difference_rad.size, 1)


def halves_patterns(lines: TouchingLines, y_m: FloatArray, collector: Collector) -> FloatArray:
    """Return what a difference between the halves does to the lines, half of it to each.

    lines: Observations; the first of their common unknowns are those of their photo.
    y_m (m,): Where along the trough each is [m].
    Returns (m, 2 p): For the mean of each panel, then for its change across.
    """
    _, photo = np.unique(lines.common_index[:, 0] // MODES_PER_PHOTO, return_inverse=True)
    half = np.where(photo % 2 == 0, -0.5, 0.5) * lines.d_slope_x
    edges = collector.panel_edges_x_m
    column = np.clip(np.searchsorted(edges, lines.x_m) - 1, 0, edges.size - 2)
    across = (lines.x_m - 0.5 * (edges[1:] + edges[:-1])[column]) / (0.5 * np.diff(edges)[column])
    panel = collector.panel_index(lines.x_m, y_m)
    on = np.flatnonzero(panel >= 0)
    found = np.zeros((lines.x_m.size, 2 * collector.n_panels))
    found[on, panel[on]] = half[on]
    # The mean square of this over a panel is one.
    found[on, collector.n_panels + panel[on]] = (np.sqrt(3.0) * across * half)[on]
    return found


def halves_of(found: Beside) -> Halves | None:
    """Return the difference of the halves where photos determine it; None where they do of no panel.

    found: Amounts of the patterns.
    """
    count = found.amount.size // 2
    known = np.sqrt(np.diagonal(found.covariance)) < _KNOWN_SHARE * PRIOR_RAD
    panels = int(np.count_nonzero(known[:count]))
    if panels == 0:
        return None
    return Halves(found.amount[known], found.covariance[np.ix_(known, known)], panels)
