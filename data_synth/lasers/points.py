"""A facet scanned by a laser radar: points of its surface in the scanner's frame, and the truth."""

from dataclasses import dataclass

import numpy as np

from data_synth.fringes.presets import rectangle, standard_errors
from data_synth.optics.mirror import Design, SyntheticFacet
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True)
class PointScene(ShortRepr):
    """A facet and its scan.

    design, design_numbers: Shape of the facet.
    width_m, height_m: Of the facet.
    points: How many, on a square lattice that is shaken by a tenth of its step.
    sigma_point_m: Noise of each coordinate.
    distance_m: From the scanner, which is the origin of the points' frame.
    turn_rad: How the facet is turned before the scanner.
    with_errors: Whether it has the slope errors of a good facet.
    """

    design: str = "paraboloid"
    design_numbers: tuple[tuple[str, float], ...] = (("focal_length_m", 100.0),)
    width_m: float = 3.0
    height_m: float = 2.0
    points: int = 4000
    sigma_point_m: float = 1e-4
    distance_m: float = 8.0
    turn_rad: tuple[float, float, float] = (0.3, -0.2, 0.1)
    with_errors: bool = True

    @property
    def mirror(self) -> SyntheticFacet:
        """The facet."""
        outline = rectangle(self.width_m, self.height_m)
        errors = standard_errors(self.width_m, self.height_m)
        design = Design(self.design, dict(self.design_numbers))
        if not self.with_errors:
            return SyntheticFacet("facet", outline, design)
        return SyntheticFacet("facet", outline, design, errors)

    @property
    def scanner_from_mirror(self) -> RigidTransform:
        """Where the facet stands: its z axis points towards the scanner but for the turn."""
        facing = np.diag([-1.0, 1.0, -1.0])
        turn = rotation_from_vector(np.array(self.turn_rad))
        return RigidTransform(turn @ facing, np.array([0.2, -0.1, self.distance_m]))


def scan_points(scene: PointScene, seed: int) -> FloatArray:
    """Return the points in the scanner's frame, shape (n, 3) [m]."""
    rng = np.random.default_rng(seed)
    step = np.sqrt(scene.width_m * scene.height_m / scene.points)
    columns, rows = int(scene.width_m / step), int(scene.height_m / step)
    x, y = np.meshgrid((np.arange(columns) - 0.5 * (columns - 1)) * step, (np.arange(rows) - 0.5 * (rows - 1)) * step)
    places = np.stack([x.ravel(), y.ravel()]) + rng.normal(0, 0.1 * step, (2, x.size))
    height = scene.mirror.surface(places[0], places[1])[0]
    true = scene.scanner_from_mirror.apply(np.column_stack([*places, height]))
    return np.asarray(true + rng.normal(0, scene.sigma_point_m, true.shape))
