"""Printed sheets in space, flat or bent, and where lines of sight meet them."""

from dataclasses import dataclass, field

import numpy as np

from data_synth.optics.prints import Print
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array

#: What lies farther from the sheet's middle than this times its half sides has nothing to do with it. The blur
#: reaches to more than twice around small targets: with 2 their photos take 1.5 to 1.8 times as long.
_REACH = 3.0
#: Steps to the bent sheet; each gains two digits at a slope of 0.01 seen under 45 deg.
_MOST_STEPS = 12
#: A nanometre is 3e-6 px at the shortest distance here.
_EXACT_M = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class SheetShape:
    """How a sheet differs from what was drawn: the printer's scale and shear, and the paper's bending.

    sheet_from_print (2, 2): Where the printer put what was drawn at (x, y).
    bending_per_m (3,): Height ``z = a x^2 + b x y + c y^2`` over the sheet's plane [1/m].
    ripple_per_m2 (2,): Height ``d x^3 + e y^3`` in addition [1/m^2].
    """

    sheet_from_print: FloatArray = field(default_factory=lambda: np.eye(2))
    bending_per_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    ripple_per_m2: FloatArray = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        object.__setattr__(self, "sheet_from_print", float_array("sheet_from_print", self.sheet_from_print, (2, 2)))
        object.__setattr__(self, "bending_per_m", float_array("bending_per_m", self.bending_per_m, (3,)))
        object.__setattr__(self, "ripple_per_m2", float_array("ripple_per_m2", self.ripple_per_m2, (2,)))
        if not 0.5 < np.linalg.det(self.sheet_from_print) < 2:
            raise InputError(
                "sheet_from_print: a scale and shear near 1 is needed; mirrored prints have a key of their own"
            )

    @property
    def is_flat(self) -> bool:
        """Whether the sheet is a plane."""
        return not (np.any(self.bending_per_m) or np.any(self.ripple_per_m2))

    @property
    def is_true(self) -> bool:
        """Whether the printer put everything where it was drawn."""
        return bool(np.array_equal(self.sheet_from_print, np.eye(2)))

    def height_m(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the height over the sheet's plane, shape (...) [m]."""
        a, b, c = self.bending_per_m
        d, e = self.ripple_per_m2
        return np.asarray(x_m * (a * x_m + b * y_m + d * x_m**2) + y_m**2 * (c + e * y_m))

    def points_m(self, print_m: FloatArray) -> FloatArray:
        """Return where points of the drawing are on the sheet.

        print_m (..., 2): Points as drawn, x right and y up [m].
        Returns (..., 3): Points in the sheet's frame [m].
        """
        plane = print_m @ self.sheet_from_print.T
        return np.concatenate([plane, self.height_m(plane[..., 0], plane[..., 1])[..., None]], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Sheet(ShortRepr):
    """A printed sheet in space: x right and y up as seen from the front, z towards the viewer, origin in its middle.

    name: What the points on it are called after.
    ink, paper: Their brightness, 0 to 1; ink brighter than paper is a light-on-dark print.
    shape: How it differs from a flat and true print.
    transparent: Only the ink is there, on whatever lies behind: a retro-reflective sticker.
    """

    name: str
    figure: Print
    world_from_sheet: RigidTransform
    ink: float = 0.05
    paper: float = 0.85
    shape: SheetShape = field(default_factory=SheetShape)
    transparent: bool = False

    @property
    def outline_m(self) -> FloatArray:
        """The paper's edge as a closed line of points in the world, shape (64, 3) [m]."""
        wide, high = self.figure.half_size_m
        share = np.linspace(-1, 1, 16, endpoint=False)
        one = np.ones_like(share)
        edge = np.concatenate(
            [np.stack(side, axis=1) for side in ((share, -one), (one, share), (-share, one), (-one, -share))]
        )
        return self.world_from_sheet.apply(self.shape.points_m(edge * (wide, high)))

    def hit(self, sheet_from_cam: RigidTransform, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find which point of the drawing lines of sight meet.

        sheet_from_cam: Camera frame to the sheet's frame.
        x, y (...): Directions (x, y, 1) in the camera's frame.
        Returns: x and y as drawn; far away where the line of sight does not meet the sheet's front [m].
        """
        r, origin = sheet_from_cam.rotation, sheet_from_cam.translation_m
        across, up, out = (r[k, 0] * x + r[k, 1] * y + r[k, 2] for k in range(3))
        # A line of sight that leaves the front meets the sheet's plane kilometres away, where nothing is printed.
        np.minimum(out, -1e-6, out=out)
        path = -origin[2] / out
        sheet_x, sheet_y = origin[0] + path * across, origin[1] + path * up
        if not self.shape.is_flat:
            height: FloatArray | float = 0.0
            for _ in range(_MOST_STEPS):
                before, height = height, self._bent_height_m(sheet_x, sheet_y)
                path = (height - origin[2]) / out
                sheet_x, sheet_y = origin[0] + path * across, origin[1] + path * up
                if np.max(np.abs(height - before)) < _EXACT_M:
                    break
        if self.shape.is_true:
            return sheet_x, sheet_y
        a, b, c, d = np.linalg.inv(self.shape.sheet_from_print).ravel()
        return a * sheet_x + b * sheet_y, c * sheet_x + d * sheet_y

    def is_near(self, x_m: FloatArray, y_m: FloatArray) -> bool:
        """Whether all of these points of the drawing, as `hit` returns them, lie on the sheet or close to it."""
        on_sheet_m = np.stack([x_m, y_m], axis=-1) @ self.shape.sheet_from_print.T
        return bool((np.abs(on_sheet_m) < _REACH * np.array(self.figure.half_size_m)).all())

    def _bent_height_m(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        # Beyond the paper the bending would run away; what is there is not drawn.
        wide, high = (_REACH * half for half in self.figure.half_size_m)
        return self.shape.height_m(np.clip(x_m, -wide, wide), np.clip(y_m, -high, high))
