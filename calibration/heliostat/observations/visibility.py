"""How much of a target a camera sees in a concave mirror: planning where a drone must fly to calibrate heliostats."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, positive


@dataclass(frozen=True, slots=True)
class ConcaveMirror:
    """A mirror that concentrates, seen from its axis, in one of its two directions.

    size_m: Width of the mirror [m].
    edge_slope_rad: Slope of the surface at its edges; 0 for a flat mirror [rad].
    InputError: A width that is not positive, or a slope outside 0 to pi / 8.

    Gouws (2018), section 4.2.2.1, eqs. 4.1 to 4.5: the ray from the camera to the edge leaves it by twice the edge's
    slope closer to the axis. Incidence on the axis; a mirror that is seen aslant images with f cos(theta) in the
    plane of incidence and f / cos(theta) across.

    >>> mirror = ConcaveMirror.showing(2.0, size_m=1.9, camera_m=32.0, target_m=27.0)
    >>> round(float(np.degrees(mirror.edge_slope_rad)), 6)
    0.797183
    >>> round(mirror.focal_length_m, 5)
    34.13077
    """

    size_m: float
    edge_slope_rad: float

    def __post_init__(self) -> None:
        positive("size_m", self.size_m, "metres")
        if not 0 <= self.edge_slope_rad < np.pi / 8:
            raise InputError(f"edge_slope_rad: 0 to 0.39 rad is needed, not {self.edge_slope_rad}")

    @classmethod
    def showing(cls, width_m: float, *, size_m: float, camera_m: float, target_m: float) -> "ConcaveMirror":
        """Return the mirror in which so much of a target is seen.

        InputError: Lengths that are not positive, or a convex mirror would be needed.
        """
        for name, value in (("width_m", width_m), ("camera_m", camera_m), ("target_m", target_m)):
            positive(name, value, "metres")
        slope = 0.5 * (np.arctan(size_m / (2 * camera_m)) - np.arctan((width_m - size_m) / (2 * target_m)))
        if slope < 0:
            flat = size_m * (1 + target_m / camera_m)
            raise InputError(f"width_m: a flat mirror shows {flat:.3g} m there; {width_m} m would need a convex one")
        return cls(size_m, float(slope))

    @property
    def focal_length_m(self) -> float:
        """Focal length, inf where flat; from there the mirror shows as much as it is wide, at any distance [m]."""
        if self.edge_slope_rad == 0:
            return float("inf")
        return float(self.size_m / (2 * np.tan(2 * self.edge_slope_rad)))

    def visible_width_m(self, camera_m: npt.ArrayLike, target_m: npt.ArrayLike) -> FloatArray:
        """Return how much of a target is seen in the mirror.

        camera_m, target_m (...): Distances of camera (inf: the sun, whose spot has this width) and target from the
            mirror [m].
        Returns (...): Widths; negative where the rays cross before the target [m].
        """
        with np.errstate(divide="ignore"):
            ray = np.arctan(self.size_m / (2 * np.asarray(camera_m, dtype=np.float64))) - 2 * self.edge_slope_rad
        return np.asarray(self.size_m + 2 * np.asarray(target_m, dtype=np.float64) * np.tan(ray))

    def nearest_camera_m(self, width_m: float, target_m: float) -> float:
        """Return the distance beyond which no more than a target's width is seen in the mirror, and it fills it.

        InputError: From no distance so little is seen.
        """
        positive("target_m", target_m, "metres")
        ray = np.arctan((width_m - self.size_m) / (2 * target_m)) + 2 * self.edge_slope_rad
        if ray <= 0:
            least = float(self.visible_width_m(np.inf, target_m))
            raise InputError(f"width_m: even from afar {least:.3g} m of the target is seen, more than {width_m} m")
        return float(self.size_m / (2 * np.tan(ray)))

    def beam_error_per_metre(self, camera_m: float, target_m: float) -> float:
        """Return the error of the beam for each metre by which the target's centre is misjudged on the mirror.

        Returns: ``1 / camera + 1 / target - 1 / f`` [rad/m].
        """
        positive("camera_m", camera_m, "metres")
        positive("target_m", target_m, "metres")
        return float(1 / camera_m + 1 / target_m - 1 / self.focal_length_m)
