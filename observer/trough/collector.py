"""What a parabolic trough collector is: mirror, panels, absorber tube, glass and supports; nothing is estimated."""

from dataclasses import dataclass

import numpy as np

from heliogauge.errors import InputError
from heliogauge.geometry.surfaces import Quadric, trough
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array, positive

#: Refractive index of borosilicate glass at 550 nm.
BOROSILICATE_INDEX = 1.47


@dataclass(frozen=True, slots=True)
class GlassTube:
    """The envelope around the absorber tube, concentric with the design's focal line.

    outer_diameter_m, inner_diameter_m: Diameters of the two faces [m].
    index: Refractive index.
    """

    outer_diameter_m: float
    inner_diameter_m: float
    index: float = BOROSILICATE_INDEX

    def __post_init__(self) -> None:
        positive("glass outer_diameter_m", self.outer_diameter_m, "metres")
        positive("glass inner_diameter_m", self.inner_diameter_m, "metres")
        if self.inner_diameter_m >= self.outer_diameter_m:
            raise InputError(
                f"glass: the inner diameter {1e3 * self.inner_diameter_m:g} mm must be below the outer diameter "
                f"{1e3 * self.outer_diameter_m:g} mm"
            )
        if not 1.0 <= self.index < 3.0:
            raise InputError(f"glass index: {self.index:g} is not a refractive index of glass (1.3 to 1.9 is usual)")


@dataclass(frozen=True, slots=True, eq=False)
class Collector(ShortRepr):
    """A parabolic trough collector module.

    Frame: origin at the vertex in the middle of the length, x across the aperture, y along the trough, z along the
    optical axis to the absorber.

    aperture_width_m, length_m, focal_length_m: Aperture width, length along the trough and focal length of the
        design parabola [m].
    absorber_diameter_m: Outer diameter of the absorber (metal) tube [m].
    glass: The glass envelope; None for a bare tube.
    panel_edges_x_m, panel_edges_y_m (n,): Ascending positions of all edges between and around the mirror panels;
        empty for one single panel [m].
    panel_gap_m: Width of the gap between neighbouring panels [m].
    support_y_m (n,): Positions of the receiver supports (with bellows and shields) along the trough [m].
    support_width_m: Length along the trough that a support with its bellows hides [m].
    panel_height_sigma_m: How well each panel's mean height is the design's, as a standard deviation; 0: exactly
        [m].
    InputError: Dimensions that cannot be.
    """

    aperture_width_m: float
    length_m: float
    focal_length_m: float
    absorber_diameter_m: float
    glass: GlassTube | None = None
    panel_edges_x_m: FloatArray = ()  # type: ignore[assignment]
    panel_edges_y_m: FloatArray = ()  # type: ignore[assignment]
    panel_gap_m: float = 0.0
    support_y_m: FloatArray = ()  # type: ignore[assignment]
    support_width_m: float = 0.3
    panel_height_sigma_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("aperture_width_m", "length_m", "focal_length_m", "absorber_diameter_m", "support_width_m"):
            positive(f"collector {name}", getattr(self, name), "metres")
        if self.absorber_diameter_m >= self.focal_length_m:
            raise InputError(
                f"collector: absorber diameter {self.absorber_diameter_m:g} m against focal length "
                f"{self.focal_length_m:g} m; are the units right?"
            )
        if self.aperture_width_m > 12 * self.focal_length_m or self.absorber_diameter_m < 1e-3 * self.focal_length_m:
            raise InputError(
                f"collector: aperture {self.aperture_width_m:g} m, focal length {self.focal_length_m:g} m and absorber "
                f"{1e3 * self.absorber_diameter_m:g} mm do not belong to one trough; are the units right?"
            )
        if self.glass is not None and self.glass.inner_diameter_m <= self.absorber_diameter_m:
            raise InputError(
                f"collector: the glass (inner diameter {1e3 * self.glass.inner_diameter_m:g} mm) is smaller than the "
                f"absorber ({1e3 * self.absorber_diameter_m:g} mm)"
            )
        if self.panel_gap_m < 0:
            raise InputError(f"collector panel_gap_m: {self.panel_gap_m:g} m is negative")
        if not 0 <= self.panel_height_sigma_m < self.focal_length_m:
            raise InputError(
                f"collector panel_height_sigma_m: {self.panel_height_sigma_m:g} m; 0 or some millimetres are usual"
            )
        for name, half in (("panel_edges_x_m", self.aperture_width_m / 2), ("panel_edges_y_m", self.length_m / 2)):
            edges = float_array(f"collector {name}", getattr(self, name), (None,))
            if len(edges) == 0:
                edges = float_array(name, [-half, half], (2,))
            if len(edges) < 2 or not (np.diff(edges) > self.panel_gap_m).all() or np.abs(edges).max() > half + 1e-6:
                raise InputError(
                    f"collector {name}: at least two ascending positions within +-{half:g} m, further apart than the "
                    f"gap of {1e3 * self.panel_gap_m:g} mm, are needed, not {edges.tolist()}"
                )
            object.__setattr__(self, name, edges)
        object.__setattr__(self, "support_y_m", float_array("collector support_y_m", self.support_y_m, (None,)))

    @property
    def surface(self) -> Quadric:
        """The design parabola."""
        return trough(self.focal_length_m)

    @property
    def receiver_diameter_m(self) -> float:
        """Outer diameter of the receiver: of the glass, or of a bare tube [m]."""
        return self.absorber_diameter_m if self.glass is None else self.glass.outer_diameter_m

    @property
    def held_y_m(self) -> FloatArray:
        """Ascending places where the tube is held, shape (k,): supports nearer than their width are one [m]."""
        places = np.unique(self.support_y_m)
        groups = np.split(places, np.flatnonzero(np.diff(places) >= self.support_width_m) + 1) if places.size else []
        return np.array([group.mean() for group in groups], dtype=np.float64)

    @property
    def n_panels(self) -> int:
        """Number of panels."""
        return (len(self.panel_edges_x_m) - 1) * (len(self.panel_edges_y_m) - 1)

    @property
    def rim_height_m(self) -> float:
        """Height of the rim above the vertex [m]."""
        return self.aperture_width_m**2 / (16 * self.focal_length_m)

    def rows_m(self, step_m: float) -> FloatArray:
        """Return equally spaced rows along the trough in the middles of equal cells, two at least, shape (r,) [m]."""
        count = max(2, round(self.length_m / step_m))
        return np.asarray((np.arange(count) + 0.5) * (self.length_m / count) - self.length_m / 2, dtype=np.float64)

    def stations_m(self, step_m: float) -> FloatArray:
        """Return equally spaced stations of the absorber from end to end, three at least, shape (n,) [m]."""
        count = max(2, round(self.length_m / step_m))
        return np.linspace(-0.5, 0.5, count + 1) * self.length_m

    def panel_index(self, x_m: FloatArray, y_m: FloatArray) -> np.ndarray:
        """Return which panel a point of the aperture belongs to.

        Returns: Row-major number (y first, then x); -1 in gaps and outside the panels.
        """
        inside = np.ones(np.broadcast_shapes(np.shape(x_m), np.shape(y_m)), dtype=bool)
        half, parts = self.panel_gap_m / 2, []
        for edges, place in ((self.panel_edges_x_m, x_m), (self.panel_edges_y_m, y_m)):
            panel = np.searchsorted(edges, place, side="right") - 1
            inside &= (panel >= 0) & (panel < len(edges) - 1)
            # The gap is half in each of the panels beside an inner edge; the outer edges have none.
            lower, upper = edges[:-1].copy(), edges[1:].copy()
            lower[1:] += half
            upper[:-1] -= half
            own = np.clip(panel, 0, len(edges) - 2)
            inside &= (place >= lower[own]) & (place <= upper[own])
            parts.append(panel)
        column, row = parts
        return np.where(inside, row * (len(self.panel_edges_x_m) - 1) + column, -1)

    def describe(self) -> str:
        """Return the collector in words."""
        glass = "bare" if self.glass is None else f"in glass of {1e3 * self.glass.outer_diameter_m:g} mm"
        return (
            f"parabolic trough, aperture {self.aperture_width_m:g} m x {self.length_m:g} m, focal length "
            f"{self.focal_length_m:g} m, absorber {1e3 * self.absorber_diameter_m:g} mm, {glass}"
        )


def ls2() -> Collector:
    """Return Luz's LS-2 module (Owkes 2012, Table 2.1).

    Returns: The design, its mirror one panel.
    """
    return Collector(5.0, 7.89, 1.49, 0.070, GlassTube(0.115, 0.109))


def ls3() -> Collector:
    """Return Luz's LS-3 module (Owkes 2012, Table 2.1).

    Returns: The design, its mirror one panel.
    """
    return Collector(5.76, 11.9, 1.71, 0.070, GlassTube(0.115, 0.109))
