"""An optical system as SolTrace describes it: sun, optics, stages of elements; frames, surfaces and apertures.

Facts of its format and core (NREL SolTrace, BSD licence): lengths in metres, angles of sun and errors in
milliradians, turns in degrees. An element's z axis points from its origin to its aim point.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.sunlight.sun_shapes import GaussianSun, PillboxSun, SunShape, TabulatedSun
from heliogauge.validate import FloatArray

#: What the letter of an element's surface means.
SURFACES: Mapping[str, str] = {
    "f": "plane",
    "p": "paraboloid z = (c_x x^2 + c_y y^2) / 2",
    "s": "sphere of curvature c",
    "t": "cylinder along y of curvature c",
    "v": "measured slopes (.sht)",
    "m": "polynomial (.mon)",
    "o": "hyperboloid or ellipsoid",
    "g": "general conic with polynomial",
    "c": "cone",
    "d": "torus",
    "r": "polynomial of the radius (.ply)",
    "i": "cubic spline of the radius (.csi)",
    "e": "finite elements (.fed)",
}
#: What the letter of an element's aperture means.
APERTURES: Mapping[str, str] = {
    "c": "circle: diameter",
    "h": "hexagon: diameter of the circle around it",
    "t": "triangle: diameter of the circle around it",
    "r": "rectangle: width, height",
    "a": "ring: inner radius, outer radius, angle",
    "l": "section of a trough: x from, x to, length; 0, 0: a whole tube",
    "i": "triangle: three corners",
    "q": "quadrilateral: four corners",
}
_PARAMETERS = 8
#: Beyond this a direction is along y, and SolTrace's first turn is not defined by it.
_ALONG_Y = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class SystemSun:
    """The sun of a system.

    shape: Sun shape.
    towards_m (3,): Direction to the sun, of any length.
    point_source: Rays come from a point at that place instead.
    by_place: Latitude [deg], day of the year and hour, where SolTrace finds the direction from them; None: as given.
    """

    shape: SunShape
    towards_m: FloatArray
    point_source: bool = False
    by_place: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Optic:
    """One side of a pair of optical properties.

    reflectance, transmittance: Shares.
    slope_error_rad: RMS of the normal's angle in one direction [rad].
    specularity_rad: RMS of the reflected beam's angle in one direction [rad].
    distribution: "g": Gaussian, "p": pillbox.
    index: Real part of the refractive index.
    more: What else the line holds, as it stood: grating, imaginary index, and its tables.
    """

    reflectance: float
    transmittance: float = 0.0
    slope_error_rad: float = 0.0
    specularity_rad: float = 0.0
    distribution: str = "g"
    index: float = 1.0
    more: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class OpticPair:
    """Optical properties of the front and the back of elements, by a name."""

    name: str
    front: Optic
    back: Optic


@dataclass(frozen=True, slots=True, eq=False)
class SystemElement:
    """One surface.

    origin_m, aim_m (3,): Origin, and a point on its z axis, in the frame of its stage [m].
    turn_deg: Turn about z [deg].
    aperture, aperture_m: Letter of `APERTURES`, and its numbers.
    surface, surface_numbers: Letter of `SURFACES`, and its numbers (curvatures [1/m]).
    surface_file: Name of its file; empty without one.
    optics: Name of its pair of optics.
    is_mirror: Whether rays are reflected; otherwise refracted.
    is_on: Whether it counts.
    comment: What it is.
    """

    origin_m: FloatArray
    aim_m: FloatArray
    turn_deg: float
    aperture: str
    aperture_m: tuple[float, ...]
    surface: str
    surface_numbers: tuple[float, ...]
    surface_file: str
    optics: str
    is_mirror: bool = True
    is_on: bool = True
    comment: str = ""

    @property
    def stage_from_element(self) -> RigidTransform:
        """Where the element's frame stands in that of its stage."""
        return placed(self.origin_m, self.aim_m, self.turn_deg)

    def padded(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """Return numbers of aperture or surface as the format has them, eight."""
        return (*values, *(0.0,) * (_PARAMETERS - len(values)))

    def describe(self) -> str:
        """Say what it is in a line."""
        file = f" {self.surface_file}" if self.surface_file else ""
        return f"{self.comment or 'element'}: {SURFACES.get(self.surface, 'unknown surface')}{file}"


@dataclass(frozen=True, slots=True, eq=False)
class SystemStage:
    """Elements that a ray meets before those of the next stage.

    origin_m, aim_m, turn_deg: As of an element, in the frame of the system.
    is_virtual, multiple_hits, trace_through: As SolTrace has them.
    """

    name: str
    elements: tuple[SystemElement, ...]
    origin_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    aim_m: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    turn_deg: float = 0.0
    is_virtual: bool = False
    multiple_hits: bool = True
    trace_through: bool = False

    @property
    def system_from_stage(self) -> RigidTransform:
        """Where the stage's frame stands in that of the system."""
        return placed(self.origin_m, self.aim_m, self.turn_deg)


@dataclass(frozen=True, slots=True, eq=False)
class SolTraceSystem:
    """A whole system: what a ``.stinput`` file holds."""

    sun: SystemSun
    optics: tuple[OpticPair, ...]
    stages: tuple[SystemStage, ...]

    def optic(self, name: str) -> OpticPair:
        """Return a pair of optics.

        InputError: There is none of this name.
        """
        for one in self.optics:
            if one.name == name:
                return one
        raise InputError(f"optics {name!r}: there are {', '.join(one.name for one in self.optics) or 'none'}")


def placed(origin_m: FloatArray, aim_m: FloatArray, turn_deg: float) -> RigidTransform:
    """Return the place of a frame that SolTrace gives by origin, aim point and turn about z.

    InputError: Origin and aim point are one.

    With the direction d to the aim point its turns are a = atan2(d_x, d_z), b = asin(d_y) and the turn about z; rows of
    the matrix from reference to local are the local axes (Spencer and Murty, J. Opt. Soc. Am. 52 (1962) 672, eq. 2).
    """
    direction = np.asarray(aim_m, float) - np.asarray(origin_m, float)
    length = float(np.linalg.norm(direction))
    if not length > 0:
        raise InputError("origin and aim point of a SolTrace frame are one point; they give its z axis")
    direction = direction / length
    across, upward = _axes_without_turn(direction)
    turn = np.radians(turn_deg)
    axis_x = np.cos(turn) * across - np.sin(turn) * upward
    axis_y = np.sin(turn) * across + np.cos(turn) * upward
    return RigidTransform(np.column_stack([axis_x, axis_y, direction]), np.asarray(origin_m, float))


def _axes_without_turn(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    level = float(np.hypot(direction[0], direction[2]))
    sine, cosine = (direction[0] / level, direction[2] / level) if level > _ALONG_Y else (0.0, 1.0)
    across = np.array([cosine, 0.0, -sine])
    upward = np.array([-sine * direction[1], level, -cosine * direction[1]])
    return across, upward


def aim_and_turn(reference_from_local: RigidTransform, reach_m: float = 1.0) -> tuple[FloatArray, float]:
    """Return aim point [m] and turn about z [deg] of a frame, as SolTrace has them.

    reach_m: Distance of the aim point from the origin [m].
    """
    axis_x, direction = reference_from_local.rotation[:, 0], reference_from_local.rotation[:, 2]
    across, upward = _axes_without_turn(direction)
    turn = float(np.degrees(np.arctan2(-axis_x @ upward, axis_x @ across)))
    return reference_from_local.translation_m + reach_m * direction, turn


def sun_of_letter(letter: str, sigma_mrad: float, half_width_mrad: float, table: FloatArray) -> SunShape:
    """Return the sun shape that SolTrace names by a letter.

    table (n, 2): Angles [mrad] and radiance, of the letter d.
    InputError: Another letter, or a table that is no sun shape.
    """
    if letter == "g":
        return GaussianSun(1e-3 * sigma_mrad)
    if letter == "p":
        return PillboxSun(1e-3 * half_width_mrad)
    if letter == "d":
        if len(table) == 0:
            raise InputError("a sun shape of the user's own (d) needs rows of USER SHAPE DATA")
        return TabulatedSun(1e-3 * table[:, 0], table[:, 1], "sun shape of SolTrace")
    raise InputError(f"sun shape {letter!r}: g (Gaussian), p (pillbox) and d (table) are those of SolTrace")


def sun_table(shape: SunShape, points: int = 100) -> FloatArray:
    """Return a sun shape as SolTrace's table, shape (n, 2): angle [mrad], relative radiance.

    A table of its own is returned as it is; others at even steps to where they end.
    """
    if isinstance(shape, TabulatedSun):
        return np.column_stack([1e3 * shape.angle_rad, shape.radiance_table / shape.radiance_table[0]])
    angles = np.linspace(0, shape.limit_rad, points)
    return np.column_stack([1e3 * angles, shape.radiance(angles)])
