"""Lines over a photo: outlines of facets, and of the source's image in them."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from deflectometry.overlay.source_image import FacetPixels, Source, outline_px, seen_places
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import FloatArray

#: Table of the lines.
OVERLAY_FILE = "overlay.csv"
#: Its kinds of lines.
FACET_LINE, DESIGN_LINE, MEASURED_LINE = "facet", "as designed", "as measured"
#: Lines are sharp to this share of a pixel.
_FINER = 4


@dataclass(frozen=True, slots=True, eq=False)
class OverlayLine:
    """A line over a photo.

    photo, facet: Names.
    kind: One of `FACET_LINE`, `DESIGN_LINE`, `MEASURED_LINE`.
    line_px (n, 2): Its vertices [px].
    """

    photo: str
    facet: str
    kind: str
    line_px: FloatArray


def line_table(lines: Iterable[OverlayLine]) -> dict[str, list[Any]]:
    """Return the columns of the table of lines: one row for each vertex."""
    points = [
        (one.photo, one.facet, one.kind, number, *place)
        for number, one in enumerate(lines)
        for place in one.line_px.tolist()
    ]
    keys = ("photo", "facet", "kind", "line", "x_px", "y_px")
    return {key: [row[k] for row in points] for k, key in enumerate(keys)}


def lines_over(
    camera: Camera,
    photo: str,
    pose: RigidTransform,
    facet: Facet,
    source: Source,
    measured_rad: Mapping[str, FloatArray],
) -> Iterator[OverlayLine]:
    """Yield a facet's outline in a photo, and the source's image in it as designed and with other turns.

    pose: From the heliostat to the camera.
    measured_rad: Other turns of the facet by the kind of line.
    """
    outline = outline_px(camera, pose, facet)
    if not np.isfinite(outline).all():
        return
    yield OverlayLine(photo, facet.name, FACET_LINE, np.vstack([outline, outline[:1]]))
    for kind, turn in ({DESIGN_LINE: np.zeros(2)} | dict(measured_rad)).items():
        for line in _image_lines(camera, pose, facet, turn, source, outline):
            yield OverlayLine(photo, facet.name, kind, line)


def _image_lines(
    camera: Camera, pose: RigidTransform, facet: Facet, turn_rad: FloatArray, source: Source, outline: FloatArray
) -> Iterator[FloatArray]:
    """Yield the outline of the source's image within a facet, to a quarter of a pixel."""
    low = np.floor(outline.min(axis=0)).astype(int) - 1
    high = np.ceil(outline.max(axis=0)).astype(int) + 1
    columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    seen = seen_places(FacetPixels.of(camera, pose, facet, pixels), facet, turn_rad, source)
    within = np.minimum(*(half - np.abs(one) for half, one in zip(source.half_m, seen, strict=True)))
    if source.is_disc:
        within = source.half_m[0] - np.hypot(*seen)
    field = np.nan_to_num(within, nan=-1e3).reshape(columns.shape).astype(np.float32)
    size = (field.shape[1] * _FINER, field.shape[0] * _FINER)
    fine = cv2.resize(field, size, interpolation=cv2.INTER_LINEAR)
    inside = np.zeros(fine.shape, np.uint8)
    # Centres of fine pixels: (k + 0.5) / finer - 0.5.
    cv2.fillPoly(inside, [np.rint((outline - low + 0.5) * _FINER - 0.5).astype(np.int32)], 1)
    found, _ = cv2.findContours(((fine > 0) & (inside > 0)).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for contour in found:
        if len(contour) > 8:
            line = (contour[:, 0, :].astype(np.float64) + 0.5) / _FINER - 0.5 + low
            yield np.vstack([line[::2], line[:1]])
