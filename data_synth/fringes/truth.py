"""The truth behind a synthetic measurement: what every pixel saw, and the exact surface at any point."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from data_synth.optics.mirror import Design, SyntheticFacet, transform_to_json
from data_synth.optics.surface_errors import SurfaceErrors
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

#: Version of truth.json; raised when a key changes its meaning.
TRUTH_SCHEMA = 1

#: The per-pixel arrays of `PixelTruth`, with their units, in the order of the file.
PIXEL_ARRAYS = {
    "x_m": "m",
    "y_m": "m",
    "height_m": "m",
    "slope_x": "rad",
    "slope_y": "rad",
    "slope_error_x": "rad",
    "slope_error_y": "rad",
    "u": "fraction of the display from its left edge",
    "v": "fraction of the display from its top edge",
}


@dataclass(frozen=True, slots=True, eq=False)
class PixelTruth:
    """What the centre of each pixel sees.

    facet_index (h, w): Number of the facet, -1 beside the mirror.
    x_m, y_m (h, w): Point of the mirror in the facet's frame, NaN beside it [m].
    height_m (h, w): True height there [m].
    slope_x, slope_y (h, w): True slopes there [rad].
    slope_error_x, slope_error_y (h, w): True slope minus design slope at the same x, y [rad].
    u, v (h, w): Display coordinates seen there; outside 0..1 or NaN where the ray misses the display.
    """

    facet_index: npt.NDArray[np.int16]
    x_m: FloatArray
    y_m: FloatArray
    height_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    slope_error_x: FloatArray
    slope_error_y: FloatArray
    u: FloatArray
    v: FloatArray

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> "PixelTruth":
        """Return arrays that see no mirror yet.

        shape: Rows and columns.
        """
        return cls(np.full(shape, -1, dtype=np.int16), *(np.full(shape, np.nan) for _ in PIXEL_ARRAYS))


@dataclass(frozen=True, slots=True, eq=False)
class FringeTruth:
    """Truth of a synthetic fringe measurement.

    facets: The mirror's facets with their exact surfaces.
    pixels: What each pixel centre sees.
    parameters: Everything that went into the images, as plain values (the content of truth.json).
    """

    facets: tuple[SyntheticFacet, ...]
    pixels: PixelTruth
    parameters: Mapping[str, Any]

    def slopes(self, x_m: FloatArray, y_m: FloatArray, *, facet: int = 0) -> tuple[FloatArray, FloatArray]:
        """Evaluate the true slopes anywhere on a facet.

        x_m, y_m (...): Points in the facet's frame [m].
        Returns: slope_x and slope_y [rad].
        """
        _, slope_x, slope_y = self.facets[facet].surface(np.asarray(x_m), np.asarray(y_m))
        return slope_x, slope_y

    def slope_errors(self, x_m: FloatArray, y_m: FloatArray, *, facet: int = 0) -> tuple[FloatArray, FloatArray]:
        """Evaluate the true slope errors (true minus design) anywhere on a facet.

        x_m, y_m (...): Points in the facet's frame [m].
        """
        _, error_x, error_y = self.facets[facet].errors.evaluate(np.asarray(x_m), np.asarray(y_m))
        return error_x, error_y

    def height(self, x_m: FloatArray, y_m: FloatArray, *, facet: int = 0) -> FloatArray:
        """Evaluate the true height anywhere on a facet.

        x_m, y_m (...): Points in the facet's frame [m].
        Returns: Height over the facet's x, y plane [m].
        """
        return self.facets[facet].surface(np.asarray(x_m), np.asarray(y_m))[0]


def facet_to_json(facet: SyntheticFacet) -> dict[str, Any]:
    """Return a facet as plain values.

    Returns: Name, outline, design, error terms and pose.
    """
    return {
        "name": facet.name,
        "outline_m": facet.outline_m.tolist(),
        "design": facet.design.to_json(),
        "errors": facet.errors.to_json(),
        "mirror_from_facet": transform_to_json(facet.mirror_from_facet),
    }


def facet_from_json(values: Mapping[str, Any]) -> SyntheticFacet:
    """Rebuild the facet that `facet_to_json` wrote.

    InputError: A key is missing.
    """
    try:
        design = values["design"]
        return SyntheticFacet(
            values["name"],
            values["outline_m"],
            Design(design["shape"], design["parameters"], transform_from_json(design["optic_from_facet"])),
            SurfaceErrors.from_json(values["errors"]),
            transform_from_json(values["mirror_from_facet"]),
        )
    except KeyError as error:
        raise InputError(f"truth.json: key {error} is missing") from error


def transform_from_json(values: Mapping[str, Any]) -> RigidTransform:
    """Rebuild a transform from ``rotation_vector_rad`` and ``translation_m``."""
    return RigidTransform.from_rotation_vector(values["rotation_vector_rad"], values["translation_m"])
